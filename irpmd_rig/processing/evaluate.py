"""From the depth map to facets and steps with their uncertainties, on the part of the picture that is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import (
    DEFINITION,
    FacetPlane,
    RigGeometry,
    Step,
    depth_influences,
    find_facets,
    fit_facets,
    step_heights,
)
from irpmd_rig.core.errors import EvaluationError

# The paper's stage is accurate to 1 um, at either position.
SIGMA_TRAVEL_MM = float(np.sqrt(2) * 1e-3)

Map = NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Facets of the object and the steps between them.

    Attributes
    ----------
    labels : ndarray of int32, (H, W)
        Facets, 1 and up; 0 elsewhere.
    planes : tuple of FacetPlane
        One a facet.
    noise_mm : float
        Noise of a pixel of the depth map; NaN if no facet was found.
    steps : tuple of Step
        Between neighbouring facets; empty where there are none or they are curved.
    definition : str
        What a step is.
    without_steps : str
        Why there are no steps; empty if there are.
    """

    labels: NDArray[np.int32]
    planes: tuple[FacetPlane, ...]
    noise_mm: float
    steps: tuple[Step, ...]
    definition: str
    without_steps: str


def evaluate(
    depth_mm: Map, phases_rad: Sequence[Map], geometry: RigGeometry, rays: NDArray[np.float64], *, d_mm: float
) -> Evaluation:
    """Find the facets, fit planes, and take the steps between them if they are flat.

    Parameters
    ----------
    depth_mm : ndarray, (H, W)
        Height; NaN where unknown.
    phases_rad : sequence of four ndarray, (H, W)
        Reference 1 and 2, measured 1 and 2.
    geometry : RigGeometry
        Frame M and the uncertainty of d.
    rays : ndarray, (H, W, 3)
        Of the same pixels.
    d_mm : float
        Distance to the glass at position 1.

    Returns
    -------
    Evaluation
        Without facets, and the reason said, where none can be found.
    """
    depth_mm = depth_mm.astype(np.float64)
    try:
        facets = find_facets(depth_mm)
        planes = fit_facets(depth_mm, facets, geometry.frame, rays)
    except EvaluationError as error:
        return Evaluation(np.zeros(depth_mm.shape, np.int32), (), float("nan"), (), DEFINITION, str(error))
    curved = [str(plane.facet) for plane in planes if not plane.flat]
    without = ""
    if len(planes) < 2:
        without = "one facet was found, a step needs two"
    elif curved:
        without = f"facet {', '.join(curved)} is curved: a step between planes is not defined for it"
    steps: tuple[Step, ...] = ()
    if not without:
        influences = depth_influences(
            tuple(phases_rad),
            depth_mm,
            geometry.frame,
            rays,
            d_mm=d_mm,
            sigma_d_mm=geometry.sigma_d_mm,
            sigma_delta_d_mm=SIGMA_TRAVEL_MM,
        )
        steps = step_heights(planes, facets, influences)
    return Evaluation(facets.labels, planes, facets.noise_mm, steps, DEFINITION, without)
