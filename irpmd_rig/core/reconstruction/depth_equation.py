"""The paper's depth with its uncertainty: the depth equation on the phases of a reference and an object."""

from __future__ import annotations

import numpy as np

from irpmd_rig.core.errors import FramesError, MeasurementError
from irpmd_rig.core.reconstruction.direct_depth import direct_depth
from irpmd_rig.core.reconstruction.views import DepthMap, Views


def equation_depth(views: Views, references: Views, *, d_mm: float) -> DepthMap:
    """Depth by the depth equation.

    Parameters
    ----------
    views : Views
        Phases of the object at two positions.
    references : Views
        Phases of the reference mirror at the same positions, in the same window.
    d_mm : float
        Distance from the reference plane to the glass at the first position.

    Returns
    -------
    DepthMap
        As `direct_depth`; sigma from the sigmas of all four phases. No slopes.

    Raises
    ------
    MeasurementError
        If there are not two positions, or as `direct_depth`.
    FramesError
        If windows or positions differ.

    Notes
    -----
    With D = M + R and the travel delta, derivatives of h = (d (M - R) - delta (r1 - m1)) / D are
    (d + delta - h) / D by m1, (h - d) / D by m2, -(d + delta + h) / D by r1 and (d + h) / D by r2.
    """
    if len(views.positions_mm) != 2:
        raise MeasurementError(
            f"the depth equation takes two stage positions, not {len(views.positions_mm)}: choose triangulation"
        )
    if views.window != references.window or len(references.positions_mm) != 2:
        raise FramesError("object and reference must have one window and the same two positions")
    first, second = views.positions_mm
    travel = second - first
    r1, r2 = references.phases_rad
    m1, m2 = views.phases_rad
    depth = np.asarray(direct_depth(r1, r2, m1, m2, d_mm=d_mm, delta_d_mm=travel), dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        total = (m1 - m2) + (r1 - r2)
        leverage = (d_mm + travel - depth, d_mm - depth, d_mm + travel + depth, d_mm + depth)
        sigmas = (*views.sigmas_rad, *references.sigmas_rad)
        variance = sum((lever * sigma) ** 2 for lever, sigma in zip(leverage, sigmas, strict=True))
        sigma = np.where(np.isfinite(depth), np.sqrt(variance) / np.abs(total), np.nan)
    return DepthMap(depth.astype(np.float32), sigma.astype(np.float32))
