"""What a measurement of an object should have found, written into one file for whoever compares."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sims.errors import SimulationError
from sims.optics import trace
from sims.setup import Setup
from sims.truth import true_d_mm, true_steps_mm

if TYPE_CHECKING:
    from sims.world import World


def write_truth(world: "World", name: str, out: Path) -> None:
    """Write the truth of an object that stands in place of the mirror, glass in place, stage1 at 0.

    The file (.npz) holds `point_mm` (H, W, 3), the point of frame M that each pixel sees (NaN: none); `facet`
    (H, W), its facet in rising order (-1: none); `steps_mm`, the true steps; `d_mm`, the distance from the
    reference plane to the glass; `focal_px`, the camera's focal lengths; `seed` and `object`.

    Raises
    ------
    SimulationError
        The world has no such object, or the file cannot be written.
    """
    steps_mm = true_steps_mm(world, name)
    seen = trace(world, Setup(name))
    try:
        with out.open("wb") as file:
            np.savez(
                file,
                point_mm=seen.point_mm,
                facet=seen.facet,
                steps_mm=np.array(steps_mm),
                d_mm=np.array(true_d_mm(world)),
                focal_px=np.array(world.camera.fc_px),
                seed=np.array(world.seed),
                object=np.array(name),
            )
    except OSError as error:
        raise SimulationError(f"{out} cannot be written: {error}") from None
