"""What uncertain distances and imperfect alignment do to heights from the depth equation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.frame import ReferenceFrame


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
class AlignmentTolerance:
    """How well a rig is aligned by hand: what the depth equation takes for exact.

    Attributes
    ----------
    stage_axis_rad : float
        Stage axis off the reference's normal, in the plane in which the phase grows.
    phase_curvature_per_mm : float
        Relative change of the fringe pitch on the glass per mm. A projector tilted by 1 deg at a throw of 1.67 m
        gives 1.0e-5, 0.3 % of distortion at the picture's edge as much again.
    """

    stage_axis_rad: float = np.deg2rad(0.1)
    phase_curvature_per_mm: float = 1.5e-5


def depth_influences(
    phases_rad: tuple[NDArray[np.floating], ...],
    depth_mm: NDArray[np.floating],
    frame: ReferenceFrame,
    rays: NDArray[np.float64],
    *,
    d_mm: float,
    sigma_d_mm: float,
    sigma_delta_d_mm: float,
    tolerance: AlignmentTolerance | None = None,
) -> tuple[Influence, ...]:
    """Changes of the depth equation's heights with its distances and with misalignment.

    Parameters
    ----------
    phases_rad : tuple of four ndarray, (H, W)
        Reference 1 and 2, measured 1 and 2, as for `irpmd_rig.core.direct_depth`.
    depth_mm : ndarray, (H, W)
        Its result.
    frame, rays
        The camera, for the angle theta of each ray to the reference's normal.
    d_mm : float
        The distance used.
    sigma_d_mm, sigma_delta_d_mm : float
        Standard deviations of d and of the travel.
    tolerance : AlignmentTolerance, optional
        A rig aligned by hand by default.

    Returns
    -------
    tuple of Influence
        d and delta_d as calibration, stage axis and phase curvature as alignment.

    Notes
    -----
    dh/dd = (M - R) / (M + R) and dh/d(delta_d) = -(r1 - m1) / (M + R) from the depth equation. An axis off by eps
    shifts M and R alike, so that h changes by h eps / tan(theta); a curvature kappa of the phase makes M - R differ
    by 4 kappa delta_d tan^2(theta) h, so that h changes by 2 d kappa tan(theta) h. Both to first order; checked
    against the traced figures of the physics notes, section 4.
    """
    tolerance = tolerance or AlignmentTolerance()
    r1, r2, m1, m2 = (phase.astype(np.float64) for phase in phases_rad)
    directions = frame.directions(rays)
    tangent = directions[..., 0] / directions[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        total = (m1 - m2) + (r1 - r2)
        by_d = ((m1 - m2) - (r1 - r2)) / total
        by_travel = -(r1 - m1) / total
        by_axis = depth_mm / tangent
    by_curvature = 2 * d_mm * tangent * depth_mm
    return (
        Influence("d", "calibration", sigma_d_mm * by_d),
        Influence("delta_d", "calibration", sigma_delta_d_mm * by_travel),
        Influence("stage axis", "alignment", tolerance.stage_axis_rad * by_axis),
        Influence("phase curvature", "alignment", tolerance.phase_curvature_per_mm * by_curvature),
    )
