"""Worlds of the accuracy bench: a rig as misaligned as a real one, its axes and signs drawn from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from irpmd_rig.shipped import CONFIGS

GLASS_DEG = 0.1
STAGE_DEG = 0.1
PROJECTOR_DEG = 1.0
NOISE = 2.0
"""How many times the read noise is in the world with larger noise."""

_WARP = 0.0005  # of half the DMD's width
_BASE = "misaligned.yaml"

Content = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Change:
    """What a world has beside its drawn misalignment.

    Attributes
    ----------
    bow_um
        Of the glass.
    warped
        Whether the projector distorts by 0.05 % of half its width as no lens model describes.
    read_noise
        How many times the camera's read noise is as large.
    stage_about_y_deg
        Tilt of stage1's axis about y, in place of the drawn one; None: as drawn.
    """

    bow_um: float = 0.0
    warped: bool = False
    read_noise: float = 1.0
    stage_about_y_deg: float | None = None


def write_world(path: Path, seed: int, change: Change) -> Content:
    """Write the world file of a seed.

    The shipped world ``misaligned`` with its glass and stage axis tilted by 0.1 degrees and its projector by 1 degree,
    each about an axis in the plane whose azimuth is drawn; the sign of the projector's distortion (0.3 %) is drawn
    too. One micrometre of stage noise, a projector gamma of 1.05 and a blur of 0.7 px are those of the file.

    Returns
    -------
    dict
        Its content.
    """
    yaml = YAML(typ="safe", pure=True)
    world: Content = yaml.load((CONFIGS / "worlds" / _BASE).read_text())
    rng = np.random.default_rng(seed)
    glass, stage, projector = world["glass"], world["stage1"], world["projector"]
    _tilt(glass, "tilt_about_{}_deg", GLASS_DEG, rng)
    _tilt(stage, "axis_tilt_about_{}_deg", STAGE_DEG, rng)
    _tilt(projector, "tilt_about_{}_deg", PROJECTOR_DEG, rng)
    sign = float(rng.choice([-1.0, 1.0]))
    projector["distortion"] = [sign * value for value in projector["distortion"]]
    if change.stage_about_y_deg is not None:
        stage |= {"axis_tilt_about_x_deg": 0.0, "axis_tilt_about_y_deg": change.stage_about_y_deg}
    glass["bow_um"] = change.bow_um
    if change.warped:
        projector["warp_amplitude_px"] = _WARP * projector["size_px"][0] / 2
    world["camera"]["read_noise_e"] *= change.read_noise
    world["seed"] = seed
    with path.open("w") as file:
        yaml.dump(world, file)
    return world


def rig_facts(world: Mapping[str, Any]) -> Content:
    """What a rig file says of such a world: nominal places, misalignments excluded."""
    camera, glass, board = world["camera"], world["glass"], world["board"]
    return {
        "name": "simulated rig",
        "drawing": {
            "camera_xy_mm": camera["position_mm"][:2],
            "heading": camera["axis"][:2],
            "d_point_mm": glass["centre_mm"][:2],
        },
        "checkerboard": {"squares": board["squares"], "square_mm": board["square_mm"]},
        "stage1": {"in_position_mm": 0.01},
        "calibration": {"max_age_days": None},
    }


def _tilt(part: Content, name: str, size_deg: float, rng: np.random.Generator) -> None:
    azimuth = rng.uniform(0, 2 * np.pi)
    part[name.format("x")] = float(size_deg * np.cos(azimuth))
    part[name.format("y")] = float(size_deg * np.sin(azimuth))
