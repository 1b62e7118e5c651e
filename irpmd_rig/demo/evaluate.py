"""From the depth map to facets and steps with their uncertainties."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import DEFINITION, Step, depth_influences, find_facets, fit_facets, step_heights
from irpmd_rig.demo.procedure import Calibration, Measurement

# The paper's stage is accurate to 1 um, at either position.
_SIGMA_TRAVEL_MM = np.sqrt(2) * 1e-3


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Facets of the object and the steps between them.

    Attributes
    ----------
    labels : ndarray of int32, (H, W)
        Facets, 1 and up; 0 elsewhere.
    facet_count : int
        Their number.
    steps : tuple of Step
        Between neighbouring facets; empty for curved ones.
    definition : str
        What a step is.
    """

    labels: NDArray[np.int32]
    facet_count: int
    steps: tuple[Step, ...]
    definition: str


def evaluate(measurement: Measurement, calibration: Calibration) -> Evaluation:
    """Find the facets, fit planes, and take the steps between them if they are flat."""
    geometry = calibration.geometry
    facets = find_facets(measurement.depth_mm)
    planes = fit_facets(measurement.depth_mm, facets, geometry.frame, calibration.rays)
    steps: tuple[Step, ...] = ()
    if len(planes) > 1 and all(plane.flat for plane in planes):
        influences = depth_influences(
            (
                *(reference.phase_rad for reference in calibration.references),
                *(phase.phase_rad for phase in measurement.phases),
            ),
            measurement.depth_mm,
            geometry.frame,
            calibration.rays,
            d_mm=geometry.d_mm,
            sigma_d_mm=geometry.sigma_d_mm,
            sigma_delta_d_mm=_SIGMA_TRAVEL_MM,
        )
        steps = step_heights(planes, facets, influences)
    return Evaluation(facets.labels, facets.count, steps, DEFINITION)
