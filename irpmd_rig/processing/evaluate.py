"""From a depth map, pixel by pixel, to facets and steps with their uncertainties."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import (
    DEFINITION,
    FacetPlane,
    Facets,
    ReferenceFrame,
    Step,
    find_facets,
    fit_facets,
    step_heights,
)
from irpmd_rig.core.errors import EvaluationError

Map = NDArray[np.floating]
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What a quantity that is not known exactly does to the heights of the facets.

    Attributes
    ----------
    kind
        ``random``, ``calibration``, or ``alignment``: taken for granted by the method, within a tolerance.
    mean_mm
        Change of every facet's mean height by one standard deviation or tolerance, (facets,).
    """

    kind: Literal["random", "calibration", "alignment"]
    mean_mm: Array


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Facets of the object and the steps between them.

    Attributes
    ----------
    facets : Facets or None
        Where they are; None where none was found.
    planes : tuple of FacetPlane
        One a facet.
    noise_mm : float
        Noise of a pixel of the depth map; NaN if no facet was found.
    steps : tuple of Step
        Between neighbouring facets; empty where there are none or they are curved.
    covariance_um2 : ndarray, (steps, steps)
        Of the steps, all parts together.
    definition : str
        What a step is.
    without_steps : str
        Why there are no steps; empty if there are.
    """

    facets: Facets | None
    planes: tuple[FacetPlane, ...]
    noise_mm: float
    steps: tuple[Step, ...]
    covariance_um2: Array
    definition: str
    without_steps: str


def evaluate(
    depth_mm: Map,
    frame: ReferenceFrame,
    rays: NDArray[np.float64],
    changes: Callable[[Facets], Sequence[Change]],
) -> Evaluation:
    """Find the facets, fit planes, and take the steps between them if they are flat.

    Parameters
    ----------
    depth_mm : ndarray, (H, W)
        Height; NaN where unknown.
    frame : ReferenceFrame
        The camera's place in frame M.
    rays : ndarray, (H, W, 3)
        Of the same pixels.
    changes : callable
        Tells what uncertain quantities do to the facets that were found.

    Returns
    -------
    Evaluation
        Without facets, and the reason said, where none can be found.
    """
    depth_mm = depth_mm.astype(np.float64)
    try:
        facets = find_facets(depth_mm)
        planes = fit_facets(depth_mm, facets, frame, rays)
    except EvaluationError as error:
        return Evaluation(None, (), float("nan"), (), np.empty((0, 0)), DEFINITION, str(error))
    curved = [str(plane.facet) for plane in planes if not plane.flat]
    if len(planes) < 2 or curved:
        without = (
            f"facet {', '.join(curved)} is curved: a step between planes is not defined for it"
            if curved
            else "one facet was found, a step needs two"
        )
        return Evaluation(facets, planes, facets.noise_mm, (), np.empty((0, 0)), DEFINITION, without)
    steps = step_heights(planes)
    parts = step_covariances_um2(planes, changes(facets))
    steps = tuple(
        replace(
            step,
            random_um=float(np.sqrt(parts["random"][k, k])),
            calibration_um=float(np.sqrt(parts["calibration"][k, k])),
            alignment_um=float(np.sqrt(parts["alignment"][k, k])),
        )
        for k, step in enumerate(steps)
    )
    return Evaluation(facets, planes, facets.noise_mm, steps, sum(parts.values(), np.zeros(())), DEFINITION, "")


def step_covariances_um2(planes: Sequence[FacetPlane], changes: Sequence[Change]) -> dict[str, Array]:
    """Covariance of the steps between neighbouring planes, part by part: neighbours share a plane.

    Parameters
    ----------
    planes : sequence of FacetPlane
        Of which the steps are taken, halfway between their centres.
    changes : sequence of Change
        Uncertain quantities, each independent of the others.

    Returns
    -------
    dict
        ``random``, ``calibration`` and ``alignment``: (steps, steps), um^2.
    """
    count = len(planes)
    by_plane = np.zeros((count - 1, 3 * count))
    for k, (lower, upper) in enumerate(pairwise(planes)):
        middle = 0.5 * (lower.centre_mm + upper.centre_mm)
        by_plane[k, 3 * k : 3 * k + 3] = -1.0, *(lower.centre_mm - middle)
        by_plane[k, 3 * k + 3 : 3 * k + 6] = 1.0, *(middle - upper.centre_mm)
    noise = np.zeros((3 * count, 3 * count))
    for k, plane in enumerate(planes):
        noise[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = plane.covariance
    parts = {kind: np.zeros((count - 1, count - 1)) for kind in ("random", "calibration", "alignment")}
    parts["random"] += 1e6 * by_plane @ noise @ by_plane.T
    for change in changes:
        moved = 1e3 * np.diff(change.mean_mm)
        parts[change.kind] += np.outer(moved, moved)
    return parts


def facet_means(change_mm: Map, labels: NDArray[np.int32], count: int) -> Array:
    """Mean of a map over each facet, (count,); NaN pixels are left out, a facet without any has none."""
    known = np.isfinite(change_mm) & (labels > 0)
    sums = np.bincount(labels[known], weights=change_mm[known], minlength=count + 1)[1:]
    pixels = np.bincount(labels[known], minlength=count + 1)[1:]
    with np.errstate(invalid="ignore"):
        return np.asarray(sums / pixels)
