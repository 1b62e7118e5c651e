"""Results beside the truth of the world, which its own program tells as a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from irpmd_rig.bench.accuracy_lab import Done, run_sims
from irpmd_rig.programs import module_command

DEPTH_EQUATION = "depth-equation"
_RIM_PX = 3
_LEAST_PX = 20

Content = Mapping[str, Any]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What a measurement of an object should find.

    Attributes
    ----------
    z_mm
        (H, W): height of what each pixel sees.
    facets
        Pixels of each facet, without its rim.
    steps_mm
        Between neighbouring facets.
    d_mm
        From the reference plane to the glass.
    focal_px
        Of the camera.
    """

    z_mm: Array
    facets: tuple[NDArray[np.bool_], ...]
    steps_mm: tuple[float, ...]
    d_mm: float
    focal_px: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Compared:
    """A measurement by one method beside the truth.

    Attributes
    ----------
    step_errors_um, step_sigmas_um
        Measured minus true, and what was stated; none where not every facet was found.
    step_chi2
        Of all its steps together, by their stated covariance, a degree of freedom; NaN where none is stated.
    pixel_um
        Rms of the depth of a pixel inside the facets, their common mean removed.
    shape_um
        The same with every facet's own mean removed.
    absolute_um
        The same with nothing removed.
    pistons_um
        Mean error of each facet; NaN where nothing was measured of it.
    pixel_chi2
        Mean of (error / stated sigma)^2 of a pixel, the common mean removed; NaN where none is stated.
    """

    step_errors_um: tuple[float, ...]
    step_sigmas_um: tuple[float, ...]
    step_chi2: float
    pixel_um: float
    shape_um: float
    absolute_um: float
    pistons_um: tuple[float, ...]
    pixel_chi2: float

    @property
    def largest_step_um(self) -> float:
        """Largest step error without its sign; infinite where not every facet was found."""
        return max(map(abs, self.step_errors_um), default=np.inf)

    @property
    def gap_um(self) -> float:
        """Error of the step from the first facet to the second."""
        return abs(self.pistons_um[1] - self.pistons_um[0])


def ask_truth(world: Path, subject: str, size_px: int, folder: Path) -> Truth:
    """Ask the world's program; raises MeasurementError if it gives no answer."""
    file = folder / "truth.npz"
    command = module_command("sims", "truth", str(world), "--object", subject, "--out", str(file))
    run_sims([*command, "--size-px", str(size_px)])
    with np.load(file) as told:
        labels, steps = told["facet"], told["steps_mm"]
        facets = [binary_erosion(labels == k, iterations=_RIM_PX) for k in range(len(steps) + 1)]
        fx, fy = told["focal_px"]
        truth = Truth(
            told["point_mm"][..., 2],
            tuple(facets),
            tuple(map(float, steps)),
            float(told["d_mm"]),
            (float(fx), float(fy)),
        )
    file.unlink()
    return truth


NOTHING = Compared((), (), np.nan, np.nan, np.nan, np.nan, (np.nan, np.nan), np.nan)
"""What a measurement that could not be computed found."""


def compare(done: Done, truth: Truth) -> dict[str, Compared]:
    """Set what every method of a measurement found beside the truth."""
    return {name: _compared(done, content, truth) for name, content in methods_of(done.content).items()}


def methods_of(result: Content) -> dict[str, Content]:
    """What a result holds of each method that could be computed; nothing of a measurement that failed."""
    methods: Content = result.get("methods", {})
    return {name: content for name, content in methods.items() if content.get("steps") is not None}


def _compared(done: Done, content: Content, truth: Truth) -> Compared:
    errors, sigmas, chi2 = _steps(content, truth)
    depth_mm, sigma_mm = (_map(done, content.get(name)) for name in ("depth_file", "sigma_file"))
    return Compared(errors, sigmas, chi2, **_pixels(depth_mm, sigma_mm, truth))


def _steps(content: Content, truth: Truth) -> tuple[tuple[float, ...], tuple[float, ...], float]:
    steps: Sequence[Content] = content["steps"]
    if len(steps) != len(truth.steps_mm):
        return (), (), np.nan
    errors = np.array([1e3 * (step["measured_mm"] - true) for step, true in zip(steps, truth.steps_mm, strict=True)])
    sigmas = np.array([step["uncertainty_um"] for step in steps], dtype=float)
    covariance = content.get("step_covariance_um2")
    chi2 = np.nan
    if covariance is not None:
        # One that has no inverse says nothing of how far errors may go.
        with suppress(np.linalg.LinAlgError):
            chi2 = float(errors @ np.linalg.solve(np.array(covariance, dtype=float), errors) / errors.size)
    return tuple(errors.tolist()), tuple(sigmas.tolist()), chi2


def _map(done: Done, name: str | None) -> NDArray[np.float32] | None:
    if name is None:
        return None
    array: NDArray[np.float32] = np.load(done.folder.results.path(name))
    return array


def _pixels(depth_mm: NDArray[np.float32] | None, sigma_mm: NDArray[np.float32] | None, truth: Truth) -> dict[str, Any]:
    if depth_mm is None:
        nothing = dict.fromkeys(("pixel_um", "shape_um", "absolute_um", "pixel_chi2"), np.nan)
        return {**nothing, "pistons_um": (np.nan,) * len(truth.facets)}
    error_um = 1e3 * (depth_mm - truth.z_mm)
    known = [facet & np.isfinite(error_um) for facet in truth.facets]
    known = [facet for facet in known if np.count_nonzero(facet) >= _LEAST_PX]
    found = [error_um[facet] for facet in known]
    pistons = [float(errors.mean()) for errors in found]
    everything = np.concatenate(found) if found else np.full(1, np.nan)
    shape = np.concatenate([errors - errors.mean() for errors in found]) if found else everything
    pixel_chi2 = np.nan
    if sigma_mm is not None and found:
        sigma_um = 1e3 * np.concatenate([sigma_mm[facet] for facet in known])
        pixel_chi2 = float(np.nanmean(((everything - everything.mean()) / sigma_um) ** 2))
    return {
        "pixel_um": float(everything.std()),
        "shape_um": float(shape.std()),
        "absolute_um": float(np.sqrt(np.mean(everything**2))),
        "pistons_um": tuple(pistons) if len(pistons) == len(truth.facets) else (np.nan,) * len(truth.facets),
        "pixel_chi2": pixel_chi2,
    }
