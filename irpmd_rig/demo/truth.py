"""What the measurement should have found: asked of the world's program, as a file."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.demo.private_daemon import SimulatedRig
from irpmd_rig.programs import module_command, module_environment

_LIMIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Truth:
    """What the world knows and the measurement was not told.

    Attributes
    ----------
    steps_mm : list of float
        Of the traced facets, taken where the measured steps are; of the world file where not all were measured.
    d_mm : float
        Along the reference's normal at the middle of the glass.
    focal_px : tuple of float
        fx, fy.
    depth_rms_um : float
        Of the depth map against the traced surface, pixel by pixel, inside the facets found.
    seed : int
        Of the world's noise.
    """

    steps_mm: list[float]
    d_mm: float
    focal_px: tuple[float, float]
    depth_rms_um: float
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What is compared with the truth.

    Attributes
    ----------
    depth_mm, labels
        Depth map and facets (1 and up; 0: none), (H, W).
    facets
        Their number.
    steps_at_mm
        Where in frame M the steps between neighbouring facets were taken.
    """

    depth_mm: NDArray[np.float32]
    labels: NDArray[np.int32]
    facets: int
    steps_at_mm: tuple[tuple[float, float], ...]


class TruthQuestion:
    """The world's program at work; a context manager.

    Parameters
    ----------
    rig
        The simulated rig.
    subject
        The object.
    folder
        Where the answer may lie for a moment.
    """

    def __init__(self, rig: SimulatedRig, subject: str, folder: Path) -> None:
        self._file = folder / "truth.npz"
        command = module_command("sims", "truth", str(rig.world), "--object", subject)
        command += ["--out", str(self._file)]
        for name, value in (("--size-px", rig.size_px), ("--seed", rig.seed)):
            command += [] if value is None else [name, str(value)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=module_environment()
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.kill()
        self._process.communicate()

    def settle(self) -> None:
        """Wait until the answer is there.

        Raises
        ------
        MeasurementError
            The world's program gives none: the world file is wrong, say, or there is no such object.
        """
        try:
            _, complaint = self._process.communicate(timeout=_LIMIT_S)
        except subprocess.TimeoutExpired:
            raise MeasurementError(f"the world did not tell the truth within {_LIMIT_S:g} s") from None
        if self._process.returncode != 0:
            raise MeasurementError(complaint.strip().removeprefix("error: ") or "the world does not tell the truth")

    def answer(self, found: Found) -> Truth:
        """Compare a measurement with the answer, which has to be there."""
        with np.load(self._file) as file:
            told: dict[str, NDArray[Any]] = dict(file)
        points = told["point_mm"]
        error = (found.depth_mm - points[..., 2])[found.labels > 0]
        planes = [_exact_plane(points[found.labels == k + 1]) for k in range(found.facets)]
        steps = [float((planes[k + 1] - planes[k]) @ (*at_mm, 1.0)) for k, at_mm in enumerate(found.steps_at_mm)]
        world_steps = [float(step) for step in told["steps_mm"]]
        return Truth(
            steps_mm=steps if len(steps) == len(world_steps) else world_steps,
            d_mm=float(told["d_mm"]),
            focal_px=(float(told["focal_px"][0]), float(told["focal_px"][1])),
            depth_rms_um=1e3 * float(np.sqrt(np.nanmean(error**2))),
            seed=int(told["seed"]),
        )


def _exact_plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients (x, y, 1) of the plane through traced points, which have no noise."""
    known = points[np.isfinite(points).all(axis=1)]
    design = np.column_stack([known[:, :2], np.ones(len(known))])
    return np.asarray(np.linalg.lstsq(design, known[:, 2], rcond=None)[0])
