"""Step heights between neighbouring facets, in one stated definition, each with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.evaluation.facets import Facets
from irpmd_rig.core.evaluation.planes import FacetPlane

DEFINITION = (
    "step i-j: height of plane j minus that of plane i along the reference's normal, halfway between the centres of "
    "the two facets"
)


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """One uncertain quantity on which every height depends.

    Attributes
    ----------
    name : str
        What it is.
    kind : str
        "calibration" (known with a standard deviation) or "alignment" (assumed to be zero, within a tolerance).
    change_mm : ndarray, (H, W)
        Change of each pixel's height when the quantity moves by one standard deviation or tolerance.
    """

    name: str
    kind: str
    change_mm: NDArray[np.floating]


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
    calibration_um: float
    alignment_um: float

    @property
    def combined_um(self) -> float:
        """One sigma of the step, all parts together."""
        return float(np.sqrt(self.random_um**2 + self.calibration_um**2 + self.alignment_um**2))


def step_heights(
    planes: Sequence[FacetPlane],
    facets: Facets,
    influences: Sequence[Influence] = (),
) -> tuple[Step, ...]:
    """Steps between neighbouring facets.

    Parameters
    ----------
    planes : sequence of FacetPlane
        In the facets' order.
    facets : Facets
        Where each influence is averaged.
    influences : sequence of Influence
        Uncertain quantities; without any, the uncertainty holds random noise only.

    Returns
    -------
    tuple of Step
        One fewer than there are facets.

    Raises
    ------
    EvaluationError
        If there are fewer than two facets, or one of them is no plane.

    Notes
    -----
    An influence moves both facets of a step together; only the difference counts.
    """
    if len(planes) < 2:
        raise EvaluationError(f"a step needs two facets, and {len(planes)} was found")
    curved = [str(plane.facet) for plane in planes if not plane.flat]
    if curved:
        raise EvaluationError(f"facet {', '.join(curved)} is curved: a step between planes is not defined for it")
    moved = {
        influence: [float(np.nanmean(influence.change_mm[facets.mask(p.facet)])) for p in planes]
        for influence in influences
    }
    steps = []
    for index, (lower, upper) in enumerate(pairwise(planes)):
        middle = 0.5 * (lower.centre_mm + upper.centre_mm)
        parts = {"calibration": 0.0, "alignment": 0.0}
        for influence, means in moved.items():
            parts[influence.kind] += (1e3 * (means[index + 1] - means[index])) ** 2
        steps.append(
            Step(
                name=f"{lower.facet}-{upper.facet}",
                height_mm=upper.height_at(middle) - lower.height_at(middle),
                at_mm=(float(middle[0]), float(middle[1])),
                mean_height_difference_mm=upper.mean_height_mm - lower.mean_height_mm,
                random_um=1e3 * float(np.sqrt(lower.variance_at(middle) + upper.variance_at(middle))),
                calibration_um=float(np.sqrt(parts["calibration"])),
                alignment_um=float(np.sqrt(parts["alignment"])),
            )
        )
    return tuple(steps)
