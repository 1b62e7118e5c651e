"""What a method makes of an object: facets and steps with their uncertainties, one value for every method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import FacetPlane, Step, find_facets
from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.evaluation.step_report import SURFACE_STEP, StepReport, steps_of
from irpmd_rig.core.reconstruction.facet_estimate import Doubts, FacetEstimate, estimate_surfaces
from irpmd_rig.core.reconstruction.views import DepthMap
from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.evaluate import Evaluation, evaluate
from irpmd_rig.processing.job import known_number
from irpmd_rig.processing.methods import PixelDepth
from irpmd_rig.processing.object_views import ObjectViews
from irpmd_rig.processing.optics import KnownRig
from irpmd_rig.processing.regions import Window
from irpmd_rig.recipes.models import Method

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """One thing that a result was checked for.

    Attributes
    ----------
    name, says
        What was checked, and what was found, for a person.
    passed
        Whether it is as it should be.
    value, limit
        The figure and its bound; None where there is none.
    """

    name: str
    passed: bool
    says: str
    value: float | None = None
    limit: float | None = None

    def content(self) -> Content:
        """As JSON."""
        return {
            "name": self.name,
            "passed": self.passed,
            "value": None if self.value is None else known_number(self.value),
            "limit": self.limit,
            "says": self.says,
        }


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """Depth, facets and steps by one method.

    Attributes
    ----------
    method
        Which.
    maps, window
        Depth and its sigma, in a window of the picture.
    labels
        Facets in this window: int32 (h, w), 1 and up; 0 elsewhere.
    facets
        One entry a facet, as JSON.
    steps, covariance_um2
        Between neighbouring facets, and their covariance, (steps, steps).
    definition, without_steps
        What a step is; why there are none, empty if there are.
    noise_mm
        Noise of a pixel of the depth map; NaN where there is no facet.
    chi2_per_dof
        Of the phases against the facets; None for methods that do not fit them.
    checks
        Of this method alone.
    """

    method: Method
    maps: DepthMap
    window: Window
    labels: NDArray[np.int32]
    facets: tuple[Content, ...]
    steps: tuple[Step, ...]
    covariance_um2: Array
    definition: str
    without_steps: str
    noise_mm: float
    chi2_per_dof: float | None
    checks: tuple[Check, ...]


def by_pixels(method: Method, depth: PixelDepth) -> MethodResult:
    """Facets as planes through a depth map, and the steps between them if they are flat."""
    found = evaluate(depth.maps.depth_mm, depth.frame, depth.rays(), depth.changes)
    labels = np.zeros(depth.maps.depth_mm.shape, np.int32) if found.facets is None else found.facets.labels
    return MethodResult(
        method=method,
        maps=depth.maps,
        window=depth.window,
        labels=labels,
        facets=tuple(_plane_content(plane) for plane in found.planes),
        steps=found.steps,
        covariance_um2=found.covariance_um2,
        definition=found.definition,
        without_steps=found.without_steps,
        noise_mm=found.noise_mm,
        chi2_per_dof=None,
        checks=(_facets_found(found),),
    )


def _facets_found(found: Evaluation) -> Check:
    return Check("facets", not found.without_steps, found.without_steps or f"{len(found.planes)} flat facets")


def by_facets(depth: PixelDepth, seen: ObjectViews, rig: KnownRig, *, psf_px: float, max_chi2: float) -> MethodResult:
    """Planes and smooth surfaces through all phases of each facet, and the steps between them.

    Parameters
    ----------
    depth
        The triangulated one.
    seen, rig
        Phases and calibration.
    psf_px
        RMS width of the camera's blur.
    max_chi2
        Above it the facets' heights are the triangulated ones.
    """
    views = seen.views()
    try:
        facets = find_facets(depth.maps.depth_mm.astype(np.float64))
        doubts = Doubts(
            variations=rig.variations,
            shifts_mm=seen.shifts_mm(rig.variations),
            sigma_position_mm=max(position.sigma_mm for position in seen.positions),
            psf_px=psf_px,
            chi2_limit=max_chi2,
        )
        estimate = estimate_surfaces(views, depth.maps, facets, rig.model, doubts)
    except EvaluationError as error:
        return _nothing(depth, str(error))
    report, without = None, ""
    try:
        report = steps_of(estimate)
    except EvaluationError as error:
        without = str(error)
    return MethodResult(
        method="facets",
        maps=DepthMap(estimate.depth_mm, estimate.sigma_mm),
        window=depth.window,
        labels=estimate.labels,
        facets=tuple(_estimate_content(facet) for facet in estimate.facets),
        steps=() if report is None else _step_figures(report),
        covariance_um2=np.empty((0, 0)) if report is None else 1e6 * report.covariance_mm2,
        definition=SURFACE_STEP,
        without_steps=without,
        noise_mm=facets.noise_mm,
        chi2_per_dof=estimate.chi2_per_dof,
        checks=(
            Check(
                "facets explain the phases",
                estimate.chi2_per_dof <= max_chi2,
                f"chi2 {estimate.chi2_per_dof:.2f} a degree of freedom",
                estimate.chi2_per_dof,
                max_chi2,
            ),
            Check(
                "heights by triangulation and by the phases agree",
                estimate.piston == "phases",
                f"heights are taken from the {estimate.piston}",
                estimate.disagreement,
            ),
            Check("remarks", not estimate.remarks, "; ".join(estimate.remarks) or "none"),
        ),
    )


def _step_figures(report: StepReport) -> tuple[Step, ...]:
    return tuple(
        Step(
            name=name,
            height_mm=float(report.values_mm[k]),
            at_mm=(float(report.at_mm[k, 0]), float(report.at_mm[k, 1])),
            mean_height_difference_mm=float(report.means_mm[k]),
            random_um=1e3 * float(report.random_mm[k]),
            calibration_um=1e3 * float(report.calibration_mm[k]),
        )
        for k, name in enumerate(report.names)
    )


def _nothing(depth: PixelDepth, why: str) -> MethodResult:
    nothing = np.full(depth.maps.depth_mm.shape, np.nan, np.float32)
    return MethodResult(
        method="facets",
        maps=DepthMap(nothing, nothing),
        window=depth.window,
        labels=np.zeros(nothing.shape, np.int32),
        facets=(),
        steps=(),
        covariance_um2=np.empty((0, 0)),
        definition=SURFACE_STEP,
        without_steps=why,
        noise_mm=float("nan"),
        chi2_per_dof=None,
        checks=(Check("facets", passed=False, says=why),),
    )


def _plane_content(plane: FacetPlane) -> Content:
    """One facet's plane: ``z = height + slope . (xy - centre)`` in frame M."""
    return {
        "facet": plane.facet,
        "kind": "plane" if plane.flat else "curved",
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


def _estimate_content(facet: FacetEstimate) -> Content:
    variance = (
        facet.surface.gradient(facet.centre_mm) @ facet.surface.covariance @ facet.surface.gradient(facet.centre_mm)
    )
    return {
        "facet": facet.facet,
        "kind": facet.kind,
        "centre_mm": facet.centre_mm.tolist(),
        "height_mm": facet.height_mm,
        "sigma_height_um": known_number(1e3 * float(np.sqrt(variance))),
        "slope_rad": facet.slope.tolist(),
        "mean_height_mm": facet.mean_height_mm,
        "pixels": len(facet.pixels),
        "flat": facet.kind == "plane",
        "chi2_per_dof": known_number(facet.chi2_per_dof),
        "coherence": known_number(facet.coherence),
        "piston_difference_um": known_number(1e3 * facet.piston_difference_mm),
        "sigma_piston_difference_um": known_number(1e3 * facet.piston_sigma_mm),
    }
