"""Facets and steps as content of `result.json` and rows of `steps.csv`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from irpmd_rig.core import FacetPlane, Step
from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.evaluate import Evaluation
from irpmd_rig.processing.job import known_number

_COLUMNS = (
    "step", "measured_mm", "sigma_um", "random_um", "calibration_um", "alignment_um",
    "mean_height_difference_mm", "at_x_mm", "at_y_mm", "nominal_mm", "deviation_um",
)  # fmt: skip


def facet_content(plane: FacetPlane) -> Content:
    """One facet's plane: ``z = height + slope . (xy - centre)`` in frame M."""
    return {
        "facet": plane.facet,
        "centre_mm": plane.centre_mm.tolist(),
        "height_mm": plane.height_mm,
        "sigma_height_um": known_number(1e3 * float(np.sqrt(plane.covariance[0, 0]))),
        "slope_rad": plane.slope.tolist(),
        "sigma_slope_rad": np.sqrt(np.diag(plane.covariance)[1:]).tolist(),
        "mean_height_mm": plane.mean_height_mm,
        "rms_um": 1e3 * plane.rms_mm,
        "pixels": plane.pixels,
        "flat": plane.flat,
    }


def steps_content(evaluation: Evaluation, nominal_mm: Sequence[float]) -> list[Content]:
    """Steps with the parts of their uncertainty, one sigma each; what should be beside it where it was said."""
    nominal = _nominal(evaluation, nominal_mm)
    return [
        {
            "name": step.name,
            "measured_mm": step.height_mm,
            "mean_height_difference_mm": step.mean_height_difference_mm,
            "at_mm": list(step.at_mm),
            "uncertainty_um": known_number(step.combined_um),
            "random_um": known_number(step.random_um),
            "calibration_um": known_number(step.calibration_um),
            "alignment_um": known_number(step.alignment_um),
            "nominal_mm": should,
            "deviation_um": None if should is None else 1e3 * (step.height_mm - should),
        }
        for step, should in zip(evaluation.steps, nominal, strict=True)
    ]


def steps_table(evaluation: Evaluation, nominal_mm: Sequence[float]) -> list[dict[str, object]]:
    """Rows of the step table; one row without values where there is no step, so that the columns are there."""
    nominal = _nominal(evaluation, nominal_mm)
    rows = [_row(step, should) for step, should in zip(evaluation.steps, nominal, strict=True)]
    return rows or [dict.fromkeys(_COLUMNS)]


def _row(step: Step, nominal_mm: float | None) -> dict[str, object]:
    values = (
        step.name, step.height_mm, step.combined_um, step.random_um, step.calibration_um, step.alignment_um,
        step.mean_height_difference_mm, *step.at_mm, nominal_mm,
        None if nominal_mm is None else 1e3 * (step.height_mm - nominal_mm),
    )  # fmt: skip
    return dict(zip(_COLUMNS, values, strict=True))


def _nominal(evaluation: Evaluation, nominal_mm: Sequence[float]) -> list[float | None]:
    """Nominal steps beside the measured ones; None for all unless there are as many."""
    if len(nominal_mm) != len(evaluation.steps):
        return [None] * len(evaluation.steps)
    return list(nominal_mm)
