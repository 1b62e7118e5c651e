"""The phase that a pixel shows by reflection, from the plane that touches the surface where its ray meets it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]

# A bowed glass departs from its plane by micrometres over hundreds of mm: each round gains five digits.
_GLASS_ROUNDS = 3
# Relative change of a tangent plane for its derivatives: 1e-6 rad, far above rounding, far below any curvature.
_STEP = 1e-6


def reflected_phase(
    model: RigModel, rays: Array, tangents: Array, position_mm: float, *, along_y: bool = False
) -> Array:
    """Absolute phase of the glass seen by reflection.

    Parameters
    ----------
    model : RigModel
        The calibrated rig.
    rays : ndarray, (n, 3)
        Rays of the pixels in the camera's frame.
    tangents : ndarray, (n, 3)
        Tangent plane q of the surface where each ray meets it, q . P = 1 in the camera's frame, 1/mm.
    position_mm : float
        Position of stage1.
    along_y : bool
        The phase along y instead of x.

    Returns
    -------
    ndarray, (n,)
        Phase, rad.
    """
    return _phase(model, model.frame.directions(rays), model.frame.directions(tangents), position_mm, along_y)


def reflected_phase_and_gradient(
    model: RigModel, rays: Array, tangents: Array, position_mm: float, *, along_y: bool = False
) -> tuple[Array, Array]:
    """`reflected_phase`, (n,), and its derivatives by the tangent planes, (n, 3), rad mm."""
    directions, planes = model.frame.directions(rays), model.frame.directions(tangents)
    phase = _phase(model, directions, planes, position_mm, along_y)
    step = _STEP * float(np.abs(tangents).max())
    gradient = np.empty_like(tangents)
    for axis in range(3):
        # A step along an axis of the camera is one along a column of the frame's axes.
        moved = planes + step * model.frame.axes[:, axis]
        gradient[:, axis] = (_phase(model, directions, moved, position_mm, along_y) - phase) / step
    return phase, gradient


def _phase(model: RigModel, directions: Array, planes: Array, position_mm: float, along_y: bool) -> Array:
    towards = np.einsum("ni,ni->n", directions, planes)[:, None]
    points = model.still(model.frame.camera_mm + directions / towards, position_mm)
    leaving = directions - 2 * towards / np.einsum("ni,ni->n", planes, planes)[:, None] * planes
    a, b, _ = model.glass
    climb = leaving[:, 2] - a * leaving[:, 0] - b * leaving[:, 1]
    lit = points
    for _ in range(1 if model.bow_mm is None else _GLASS_ROUNDS):
        below = model.glass_z_mm(lit[:, 0], lit[:, 1]) - lit[:, 2]
        lit = lit + (below / climb)[:, None] * leaving
    return model.phase_y_rad(lit) if along_y else model.phase_rad(lit, on_glass=True)
