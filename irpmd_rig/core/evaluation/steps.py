"""Step heights between neighbouring facets, in one stated definition, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.evaluation.planes import FacetPlane

DEFINITION = (
    "step i-j: height of plane j minus that of plane i along the reference's normal, halfway between the centres of "
    "the two facets"
)


@dataclass(frozen=True, slots=True)
class Step:
    """A step between two neighbouring facets; see `DEFINITION`.

    Attributes
    ----------
    name : str
        Labels of the facets, "1-2".
    height_mm : float
        The step; positive where the second facet is higher.
    at_mm : tuple of float
        x, y of frame M at which the two planes are compared.
    mean_height_difference_mm : float
        Difference of the facets' mean heights: the same for parallel facets, other for tilted ones.
    random_um, calibration_um, alignment_um : float
        One sigma each: noise; the calibrated quantities; what the method takes for granted, within its tolerance.
    """

    name: str
    height_mm: float
    at_mm: tuple[float, float]
    mean_height_difference_mm: float
    random_um: float
    calibration_um: float = 0.0
    alignment_um: float = 0.0

    @property
    def combined_um(self) -> float:
        """One sigma of the step, all parts together."""
        return float(np.sqrt(self.random_um**2 + self.calibration_um**2 + self.alignment_um**2))


def step_heights(planes: Sequence[FacetPlane]) -> tuple[Step, ...]:
    """Steps between neighbouring facets.

    Parameters
    ----------
    planes : sequence of FacetPlane
        In the facets' order.

    Returns
    -------
    tuple of Step
        One fewer than there are facets; their uncertainty holds random noise only.

    Raises
    ------
    EvaluationError
        If there are fewer than two facets, or one of them is no plane.
    """
    if len(planes) < 2:
        raise EvaluationError(f"a step needs two facets, and {len(planes)} was found")
    curved = [str(plane.facet) for plane in planes if not plane.flat]
    if curved:
        raise EvaluationError(f"facet {', '.join(curved)} is curved: a step between planes is not defined for it")
    steps = []
    for lower, upper in pairwise(planes):
        middle = 0.5 * (lower.centre_mm + upper.centre_mm)
        steps.append(
            Step(
                name=f"{lower.facet}-{upper.facet}",
                height_mm=upper.height_at(middle) - lower.height_at(middle),
                at_mm=(float(middle[0]), float(middle[1])),
                mean_height_difference_mm=upper.mean_height_mm - lower.mean_height_mm,
                random_um=1e3 * float(np.sqrt(lower.variance_at(middle) + upper.variance_at(middle))),
            )
        )
    return tuple(steps)
