"""Accuracy of whole measurements in simulated rigs that the estimator is not told about, beside the truth."""

from __future__ import annotations

import logging
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from irpmd_rig.bench.accuracy_core import absolute_phase, depth_law_error_mm
from irpmd_rig.bench.accuracy_lab import Lab
from irpmd_rig.bench.accuracy_plan import CASES, Plan, Task
from irpmd_rig.bench.accuracy_rows import (
    AccuracyRow,
    Calibration,
    Measurement,
    calibration_rows,
    freeform_rows,
    pixel_rows,
    row,
    step_rows,
    uncertainty_rows,
)
from irpmd_rig.bench.accuracy_truth import Truth, ask_truth, compare
from irpmd_rig.core.errors import MeasurementError

Content = Mapping[str, Any]

SWEEP = "stage-tilt"
TILTS_DEG = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
_TILTED = "mirror_step_y"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One measurement of a sweep.

    Attributes
    ----------
    stage_tilt_deg
        Of the stage's axis, about y.
    method
        Of reconstruction.
    subject, seed
        What was measured, in which world.
    largest_step_error_um
        Without its sign; None where not every facet was found.
    largest_step_sigma_um
        Stated.
    """

    stage_tilt_deg: float
    method: str
    subject: str
    seed: int
    largest_step_error_um: float | None
    largest_step_sigma_um: float | None


def run(
    seeds: int = 5,
    size_px: int = 2048,
    cases: Sequence[str] = CASES,
    sweep: str | None = None,
    threads: int = 2,
) -> list[AccuracyRow] | list[SweepRow]:
    """Measure accuracy over worlds drawn from seeds, calibration from rendered, noisy frames.

    Parameters
    ----------
    seeds
        Their number; they are 1, 2, ...
    size_px
        Columns of the camera, which always has the same view.
    cases
        Of `irpmd_rig.bench.accuracy_plan.CASES`.
    sweep
        ``stage-tilt``: in place of the cases, the error of one object against the tilt of the stage's axis.
    threads
        For what is computed.

    Raises
    ------
    MeasurementError
        Cases or a sweep that there are not, or a world that cannot be simulated.
    ProcessingError
        A calibration or reference that cannot be computed.
    """
    if unknown := [case for case in cases if case not in CASES]:
        raise MeasurementError(f"there is no case {', '.join(unknown)}: there are {', '.join(CASES)}")
    if sweep not in (None, SWEEP):
        raise MeasurementError(f"there is no sweep {sweep!r}: there is {SWEEP}")
    if sweep is not None:
        return [found for seed in range(1, seeds + 1) for found in _swept(seed, size_px, threads)]
    measurements: list[Measurement] = []
    calibrations: list[Calibration] = []
    for seed in range(1, seeds + 1):
        for found in _measured(seed, size_px, cases, threads):
            (measurements if isinstance(found, Measurement) else calibrations).append(found)  # type: ignore[arg-type]
    return [
        *_core_rows(seeds, size_px),
        *step_rows(measurements),
        *pixel_rows(measurements),
        *freeform_rows(measurements),
        *calibration_rows(calibrations),
        *uncertainty_rows(measurements),
    ]


def _core_rows(seeds: int, size_px: int) -> list[AccuracyRow]:
    phases = [absolute_phase(seed, size_px) for seed in range(1, seeds + 1)]
    title = "absolute phase, A = 127, B = 100, sigma 1.5 DN"
    law = "depth equation, ideal rig, noise-free, all signs and tilts"
    return [
        row(law, "mm", [depth_law_error_mm()], must=1e-9),
        row(f"{title}: rms", "rad", [rms for rms, _ in phases], must=0.0070),
        row(f"{title}: wrong orders", "px", [float(wrong) for _, wrong in phases], must=0.0),
    ]


def _measured(seed: int, size_px: int, cases: Sequence[str], threads: int) -> Iterator[Measurement | Calibration]:
    """Carry out everything of one seed."""
    with _place() as folder:
        told = _Truths(folder, size_px)
        camera: Content = {}
        for task, done in Lab(folder, size_px, threads).carry_out(Plan(seed, folder).tasks(cases)):
            _log.info("seed %d, %s: %s %s", task.seed, task.case, done.recipe.kind, task.subject)
            if done.recipe.kind == "calibrate-camera":
                camera = done.content
            elif done.recipe.kind == "calibrate-geometry":
                yield _calibration(task, camera, done.content, told.of(task.world, _TILTED))
            elif done.recipe.kind == "measure":
                methods = compare(done, told.of(task.world, task.subject))
                yield Measurement(task.case, task.seed, task.subject, done.content.get("method", ""), methods)


def _swept(seed: int, size_px: int, threads: int) -> Iterator[SweepRow]:
    with _place() as folder:
        told = _Truths(folder, size_px)
        for task, done in Lab(folder, size_px, threads).carry_out(Plan(seed, folder).tilted(TILTS_DEG, _TILTED)):
            if done.recipe.kind != "measure" or task.stage_tilt_deg is None:
                continue
            for method, found in compare(done, told.of(task.world, task.subject)).items():
                error, sigma = found.largest_step_um, max(found.step_sigmas_um, default=np.inf)
                known = bool(np.isfinite(error))
                yield SweepRow(
                    task.stage_tilt_deg, method, task.subject, seed, error if known else None, sigma if known else None
                )


class _Truths:
    """What worlds tell of their objects, asked once."""

    def __init__(self, folder: Path, size_px: int) -> None:
        self._folder = folder
        self._size_px = size_px
        self._known: dict[tuple[Path, str], Truth] = {}

    def of(self, world: Path, subject: str) -> Truth:
        key = world, subject
        if key not in self._known:
            self._known[key] = ask_truth(world, subject, self._size_px, self._folder)
        return self._known[key]


def _calibration(task: Task, camera: Content, geometry: Content, truth: Truth) -> Calibration:
    model = geometry["rig_model"]
    return Calibration(
        task.case,
        task.seed,
        fx_px=camera["intrinsics"]["focal_px"][0] - truth.focal_px[0],
        d_um=1e3 * (geometry["d_mm"] - truth.d_mm),
        d_seen_um=1e3 * (geometry["d_seen_mean_mm"] - truth.d_mm),
        model_d_um=1e3 * (model["d_mm"] - truth.d_mm),
        chi2=model["chi2_per_dof"],
        flexible=model["flexible"],
    )


@contextmanager
def _place() -> Iterator[Path]:
    """Folder for frames and runs of one seed, which take gigabytes; gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="irpmd-accuracy-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)
