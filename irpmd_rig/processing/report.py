"""A measurement as content of `result.json` and rows of `steps.csv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Step
from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.chain import age_days
from irpmd_rig.processing.estimates import Check, MethodResult
from irpmd_rig.processing.job import Job, known_number
from irpmd_rig.processing.methods import SIGMA_TRAVEL_MM, PixelDepth
from irpmd_rig.processing.object_views import ObjectViews
from irpmd_rig.processing.optics import Optics
from irpmd_rig.processing.seen_once import SeenOnce, check_seen
from irpmd_rig.recipes.models import Method

_COLUMNS = (
    "step", "measured_mm", "sigma_um", "random_um", "calibration_um", "alignment_um",
    "mean_height_difference_mm", "at_x_mm", "at_y_mm", "nominal_mm", "deviation_um",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class MethodFiles:
    """Names of a method's maps."""

    depth: str
    sigma: str


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Everything that was computed.

    Attributes
    ----------
    seen
        Phases and stage positions.
    once
        Parts of the object that are seen at one position only.
    depth, depth_files
        The depth map of the chosen method, pixel by pixel, or of the one that it begins with.
    results, files
        By method; the chosen one first.
    not_computed
        Why a method that was to be compared has no result.
    checked
        What is known of the frames of each station.
    """

    seen: ObjectViews
    once: Sequence[SeenOnce]
    depth: PixelDepth
    depth_files: MethodFiles
    results: Mapping[Method, MethodResult]
    files: Mapping[Method, MethodFiles]
    not_computed: Mapping[Method, str]
    checked: Sequence[Content]


def result_content(job: Job, optics: Optics, measured: Measured) -> Content:
    """Everything of a measurement as JSON: the chosen method's figures on top, those of all below ``methods``."""
    record, seen = job.record, measured.seen
    method, because = job.chain.method
    chosen = measured.results[method]
    return {
        **job.header(seen.phases[0].size_px),
        "name": record.name,
        "operator": record.operator,
        "sample": record.sample,
        "notes": record.notes,
        "method": method,
        "method_because": because,
        "counts": list(seen.stations[0].counts),
        "steps_a_set": seen.stations[0].steps,
        "orientations": ["x"] if seen.phases_y is None else ["x", "y"],
        "positions": _positions(measured),
        "reference_positions_mm": None if optics.references is None else list(optics.references.positions_mm),
        "without_reference": job.chain.without_reference or None,
        "calibration": _calibration(job, optics),
        **_distances(optics, seen),
        "depth": _depth_content(measured, chosen),
        "seen_at_one_position": [patch.content() for patch in measured.once],
        "facets": list(chosen.facets),
        "step_definition": chosen.definition,
        "steps": steps_content(chosen.steps, record.nominal_steps_mm),
        "without_steps": chosen.without_steps or None,
        "measured_steps_mm": [step.height_mm for step in chosen.steps],
        "nominal_steps_mm": list(record.nominal_steps_mm),
        "methods": {
            name: _method_content(result, measured.files[name], record.nominal_steps_mm)
            for name, result in measured.results.items()
        },
        "not_computed": dict(measured.not_computed),
        "checks": [check.content() for check in (*_checks(job, optics, measured), *chosen.checks)],
    }


def _positions(measured: Measured) -> list[Content]:
    """Each stage position with what is known of its frames and its phase."""
    seen = measured.seen
    return [
        {
            "station": station.number,
            "stage1_mm": position.read_mm,
            "stage1_measured": station.measured,
            "stage1_by_the_glass_mm": position.used_mm if position.measured else None,
            "sigma_stage1_mm": known_number(position.sigma_mm),
            "exposure_us": station.entries[0].exposure_us,
            "led": station.entries[0].led,
            "intensity": station.entries[0].intensity,
            "bits": station.entries[0].bits,
            **checked,
            **phase.quality(),
        }
        for station, position, phase, checked in zip(
            seen.stations, seen.positions, seen.phases, measured.checked, strict=True
        )
    ]


def _calibration(job: Job, optics: Optics) -> Content:
    content = job.chain.content("calibrate-geometry")
    age = age_days(content)
    return {
        "age_days": None if age is None else round(age, 3),
        "off": list(job.chain.off),
        "rig_model_chi2_per_dof": None if optics.rig is None else optics.rig.chi2_per_dof,
        "rig_model_undetermined": None if optics.rig is None else content["rig_model"]["undetermined"],
        "rig_model_flexible": None if optics.rig is None else content["rig_model"]["flexible"],
    }


def _distances(optics: Optics, seen: ObjectViews) -> Content:
    """What the depth equation needs beside the phases: d at the first position, and the travel to the second."""
    geometry, (first_mm, second_mm, *_) = optics.geometry, seen.read_mm
    return {
        "d_mm": geometry.d_mm + first_mm - optics.geometry_at_mm,
        "sigma_d_mm": geometry.sigma_d_mm,
        "sigma_d_parts_um": geometry.sigma_parts_um,
        "delta_d_mm": second_mm - first_mm,
        "sigma_delta_d_mm": SIGMA_TRAVEL_MM,
        "sigma_delta_d_is": "assumed: 1 um at either position",
    }


def _depth_content(measured: Measured, chosen: MethodResult) -> Content:
    depth, (rows, columns) = measured.depth, measured.depth.window
    known = np.isfinite(depth.maps.depth_mm)
    width, height = measured.seen.phases[0].size_px
    pixels = int(np.count_nonzero(known))
    return {
        "file": measured.depth_files.depth,
        "sigma_file": measured.depth_files.sigma,
        "unit": "mm",
        "is": "height of each pixel by itself above the reference plane, positive toward the glass; NaN where unknown",
        "pixels": pixels,
        "fraction_of_picture": pixels / (width * height),
        "rows": [rows.start, rows.stop],
        "columns": [columns.start, columns.stop],
        "noise_of_a_pixel_um": known_number(1e3 * chosen.noise_mm),
        "stated_noise_of_a_pixel_um": known_number(1e3 * float(np.nanmedian(depth.maps.sigma_mm))),
    }


def _method_content(result: MethodResult, files: MethodFiles, nominal_mm: Sequence[float]) -> Content:
    known = np.isfinite(result.maps.depth_mm)
    return {
        "depth_file": files.depth,
        "sigma_file": files.sigma,
        "pixels": int(np.count_nonzero(known)),
        "noise_of_a_pixel_um": known_number(1e3 * result.noise_mm),
        "stated_noise_of_a_pixel_um": known_number(1e3 * _median(result.maps.sigma_mm)),
        "facets": list(result.facets),
        "step_definition": result.definition,
        "steps": steps_content(result.steps, nominal_mm),
        "step_covariance_um2": [[known_number(value) for value in row] for row in result.covariance_um2.tolist()],
        "without_steps": result.without_steps or None,
        "chi2_per_dof": None if result.chi2_per_dof is None else known_number(result.chi2_per_dof),
        "checks": [check.content() for check in result.checks],
    }


def _median(values: NDArray[np.float32]) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _checks(job: Job, optics: Optics, measured: Measured) -> list[Check]:
    """Checks of the whole measurement; those of its frames are in its positions."""
    off, seen = job.chain.off, measured.seen
    found = [Check("calibration", not off, "; ".join(off) or _fitness(job))]
    found.append(check_seen(measured.once, len(seen.stations)))
    if optics.rig is not None:
        limit, chi2 = job.chain.wishes.max_chi2, optics.rig.chi2_per_dof
        says = f"chi2 of the rig model {chi2:.2f} a degree of freedom"
        found.append(Check("rig model", chi2 <= limit, says, chi2, limit))
        if job.has("object", "y") and not optics.rig.along_y:
            says = "not used: the rig model does not hold for them; calibrate the geometry with orientations: [x, y]"
            found.append(Check("fringes along y", passed=False, says=says))
        offsets = [1e3 * (p.used_mm - p.read_mm) for p in seen.positions if p.measured]
        if offsets:
            worst, window_um = max(offsets, key=abs), 1e3 * job.facts.stage1.in_position_mm
            says = f"by the glass seen in the same frames the stage stood up to {worst:+.1f} um beside its reading"
            found.append(Check("stage positions", abs(worst) <= window_um, says, abs(worst), window_um))
    return found


def _fitness(job: Job) -> str:
    """Say what is known of calibrations in which no fault was found: no more."""
    used = [job.chain.content(kind) for kind in job.chain.uses]
    camera = job.record.optics is not None and all(content.get("camera_serial") is not None for content in used)
    age = all(age_days(content) is not None for content in used)
    return f"{'of this camera' if camera else 'camera not known'}, {'not too old' if age else 'age not known'}"


def steps_content(steps: Sequence[Step], nominal_mm: Sequence[float]) -> list[Content]:
    """Steps with the parts of their uncertainty, one sigma each; what should be beside it where it was said."""
    return [
        {
            "name": step.name,
            "measured_mm": step.height_mm,
            "mean_height_difference_mm": known_number(step.mean_height_difference_mm),
            "at_mm": list(step.at_mm),
            "uncertainty_um": known_number(step.combined_um),
            "random_um": known_number(step.random_um),
            "calibration_um": known_number(step.calibration_um),
            "alignment_um": known_number(step.alignment_um),
            "nominal_mm": should,
            "deviation_um": None if should is None else 1e3 * (step.height_mm - should),
        }
        for step, should in zip(steps, _nominal(steps, nominal_mm), strict=True)
    ]


def steps_table(chosen: MethodResult, nominal_mm: Sequence[float]) -> list[dict[str, object]]:
    """Rows of the step table; one row without values where there is no step, so that the columns are there."""
    pairs = zip(chosen.steps, _nominal(chosen.steps, nominal_mm), strict=True)
    return [_row(step, should) for step, should in pairs] or [dict.fromkeys(_COLUMNS)]


def _row(step: Step, nominal_mm: float | None) -> dict[str, object]:
    values = (
        step.name, step.height_mm, step.combined_um, step.random_um, step.calibration_um, step.alignment_um,
        step.mean_height_difference_mm, *step.at_mm, nominal_mm,
        None if nominal_mm is None else 1e3 * (step.height_mm - nominal_mm),
    )  # fmt: skip
    return dict(zip(_COLUMNS, values, strict=True))


def _nominal(steps: Sequence[Step], nominal_mm: Sequence[float]) -> list[float | None]:
    """Nominal steps beside the measured ones; None for all unless there are as many."""
    return list(nominal_mm) if len(nominal_mm) == len(steps) else [None] * len(steps)
