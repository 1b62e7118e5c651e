"""Steps between neighbouring surfaces of a calibrated measurement: what is random, and what is the calibration's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.reconstruction.facet_estimate import FacetEstimate, SurfaceEstimate

Array = NDArray[np.float64]

SURFACE_STEP = (
    "step i-j: height of surface j minus that of surface i along the reference's normal, at the place stated: halfway "
    "between the centres of two planes; in the middle of the gap between two surfaces of which one is curved, each "
    "continued smoothly to there"
)
# The gap is looked for on a strip of this fraction of the distance between the centres to either side of their line.
_STRIP = 0.1


@dataclass(frozen=True, slots=True)
class StepReport:
    """Steps of one object; see `SURFACE_STEP`.

    Attributes
    ----------
    names : tuple of str
        Labels of the two facets, "1-2".
    values_mm : ndarray, (k,)
        The steps; positive where the second surface is higher.
    at_mm : ndarray, (k, 2)
        x, y of frame M where the surfaces are compared.
    random_covariance_mm2, calibration_covariance_mm2 : ndarray, (k, k)
        By noise of phases and stage, other at every repetition; by the calibration, the same at every one.
        Neighbouring steps share a facet, and all the calibration.
    means_mm : ndarray, (k,)
        Difference of the mean heights of the two facets' pixels: needs no continuation, but belongs to these
        pixels only.
    definition : str
        What a step is.
    """

    names: tuple[str, ...]
    values_mm: Array
    at_mm: Array
    random_covariance_mm2: Array
    calibration_covariance_mm2: Array
    means_mm: Array
    definition: str = SURFACE_STEP

    @property
    def random_mm(self) -> Array:
        """One sigma of each step by noise, (k,)."""
        return np.asarray(np.sqrt(np.diag(self.random_covariance_mm2)))

    @property
    def calibration_mm(self) -> Array:
        """One sigma of each step by the calibration, (k,)."""
        return np.asarray(np.sqrt(np.diag(self.calibration_covariance_mm2)))

    @property
    def covariance_mm2(self) -> Array:
        """Of the steps, all parts together, (k, k)."""
        return self.random_covariance_mm2 + self.calibration_covariance_mm2

    @property
    def sigma_mm(self) -> Array:
        """One sigma of each step, all parts together, (k,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance_mm2)))


def steps_of(estimate: SurfaceEstimate) -> StepReport:
    """Steps between neighbouring facets.

    Parameters
    ----------
    estimate : SurfaceEstimate
        From `estimate_surfaces`; with a calibration's variations, the steps' uncertainty has its part.

    Returns
    -------
    StepReport
        One step fewer than there are facets.

    Raises
    ------
    EvaluationError
        If there are fewer than two facets, or a curved one ends too far from its neighbour to be continued to it, or
        lies around the same centre as its neighbour, or has no pixel near the line between their centres.
    """
    facets = estimate.facets
    if len(facets) < 2:
        raise EvaluationError(f"a step needs two facets, and {len(facets)} was estimated")
    pairs = list(pairwise(facets))
    places = np.array([_place(lower, upper) for lower, upper in pairs])
    values = [u.surface.height_mm(at) - lo.surface.height_mm(at) for (lo, u), at in zip(pairs, places, strict=True)]
    calibration = _differences(
        [
            (lo.surface.displaced_heights_mm(at), u.surface.displaced_heights_mm(at))
            for (lo, u), at in zip(pairs, places, strict=True)
        ]
    )
    return StepReport(
        names=tuple(f"{lower.facet}-{upper.facet}" for lower, upper in pairs),
        values_mm=np.array(values),
        at_mm=places,
        random_covariance_mm2=_random(
            facets,
            [(lo.surface.gradient(at), u.surface.gradient(at)) for (lo, u), at in zip(pairs, places, strict=True)],
        ),
        calibration_covariance_mm2=calibration @ calibration.T,
        means_mm=np.array([upper.mean_height_mm - lower.mean_height_mm for lower, upper in pairs]),
    )


def _differences(pairs: Sequence[tuple[Array, Array]]) -> Array:
    return np.stack([upper - lower for lower, upper in pairs])


def _place(lower: FacetEstimate, upper: FacetEstimate) -> Array:
    middle = (lower.centre_mm + upper.centre_mm) / 2
    if lower.kind == upper.kind == "plane":
        return np.asarray(middle)
    span = upper.centre_mm - lower.centre_mm
    distance = float(np.linalg.norm(span))
    if distance == 0:
        raise EvaluationError(
            f"facets {lower.facet} and {upper.facet} have the same centre: between them there is no gap for a step"
        )
    along = span / distance
    ends = []
    for facet, sign in ((lower, 1.0), (upper, -1.0)):
        offset = facet.surface.points_mm(facet.pixels)[:, :2] - middle
        near = np.abs(offset @ np.array([-along[1], along[0]])) <= _STRIP * distance
        if not near.any():
            raise EvaluationError(
                f"facet {facet.facet} has no pixel near the line between the centres of facets {lower.facet} and "
                f"{upper.facet}: where the gap between them lies is not known"
            )
        ends.append(sign * float((sign * (offset[near] @ along)).max()))
    return np.asarray(middle + along * (ends[0] + ends[1]) / 2)


def _random(facets: Sequence[FacetEstimate], gradients: Sequence[tuple[Array, Array]]) -> Array:
    """Covariance of the steps by phases and stage: a facet moves both steps that it is part of.

    `gradients` are, a step, the derivatives of the lower and of the upper height by their surfaces' coefficients.
    """
    count = len(gradients)
    covariance = np.zeros((count, count))
    stage = np.zeros((len(facets[0].surface.scattered), count))
    for index, facet in enumerate(facets):
        surface = facet.surface
        gradient = np.zeros((count, len(surface.coefficients)))
        if index > 0:
            gradient[index - 1] = gradients[index - 1][1]
        if index < count:
            gradient[index] = -gradients[index][0]
        covariance += gradient @ surface.covariance @ gradient.T
        stage += surface.scattered @ gradient.T
    return np.asarray(covariance + stage.T @ stage)
