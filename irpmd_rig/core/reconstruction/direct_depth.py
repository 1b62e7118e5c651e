"""The depth equation: height from the phases of two stage positions (the paper, eq. (5), with the sign mended)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from irpmd_rig.core.arguments import finite_number
from irpmd_rig.core.errors import FramesError, MeasurementError

# M + R is a difference of phases: below this fraction of their size it holds rounding, not geometry.
_SINGULAR = {np.dtype(np.float64): 1e-12, np.dtype(np.float32): 1e-5}


def direct_depth(
    reference_1: ArrayLike,
    reference_2: ArrayLike,
    measured_1: ArrayLike,
    measured_2: ArrayLike,
    *,
    d_mm: float,
    delta_d_mm: float,
) -> NDArray[np.floating]:
    """Height above the reference plane from absolute phases at two stage positions.

    Parameters
    ----------
    reference_1, reference_2 : array_like of float, (H, W)
        Absolute phase of the reference mirror at stage positions 1 and 2, rad; NaN where unknown.
    measured_1, measured_2 : array_like of float, (H, W)
        Absolute phase of the object at the same positions, same pixels, rad.
    d_mm : float
        Distance from the reference plane to the glass at position 1.
    delta_d_mm : float
        Travel from position 1 to position 2; positive AWAY from the glass, negative toward it.

    Returns
    -------
    ndarray, (H, W)
        Height h in mm, positive toward the glass; float32 where all phases are float32, float64 otherwise. NaN
        where a phase is unknown, the equation is singular (M + R = 0), or the height would lie behind the glass.

    Raises
    ------
    FramesError
        If the maps differ in shape or are no real numbers.
    MeasurementError
        If a distance is no finite number, d is not positive, delta_d is zero or moves the mirror through the glass.

    Notes
    -----
    With R = r1 - r2 and M = m1 - m2::

        h = (d (M - R) - delta_d (r1 - m1)) / (M + R)

    (physics notes, section 1). This is minus the paper's printed eq. (5). The phase's direction, a common offset
    and the pitch q cancel. Exact for a stage along the reference's normal, a glass parallel to it and a phase
    linear on the glass; not otherwise.
    """
    maps = [_phase_map(p) for p in (reference_1, reference_2, measured_1, measured_2)]
    if len({p.shape for p in maps}) > 1:
        raise FramesError(f"the four phase maps must have one shape, not {[p.shape for p in maps]}")
    d_mm, delta_d_mm = finite_number("d_mm", d_mm), finite_number("delta_d_mm", delta_d_mm)
    _check_distances(d_mm, delta_d_mm)
    precision = np.result_type(*maps)
    r1, r2, m1, m2 = (p.astype(np.float64, copy=False) for p in maps)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        reference_change, measured_change = r1 - r2, m1 - m2
        denominator = measured_change + reference_change
        size = np.maximum.reduce([np.abs(p) for p in (r1, r2, m1, m2)])
        singular = np.abs(denominator) <= _SINGULAR[precision] * size
        height = (d_mm * (measured_change - reference_change) - delta_d_mm * (r1 - m1)) / denominator
        # No surface lies behind the glass: such a height comes from phases next to the singularity.
        impossible = height >= min(d_mm, d_mm + delta_d_mm)
    height[singular | impossible | ~np.isfinite(height)] = np.nan
    return np.asarray(height.astype(precision, copy=False))


def _phase_map(phase: ArrayLike) -> NDArray[np.floating]:
    try:
        # The masked pixels of a masked array are unknown ones.
        array = np.asarray(np.ma.filled(phase.astype(np.float64), np.nan) if np.ma.isMaskedArray(phase) else phase)
    except (ValueError, TypeError) as error:
        raise FramesError(f"a phase map must be (H, W) numbers: {error}") from None
    native = array.dtype.newbyteorder("=")
    if native.kind in "iu":
        native = np.dtype(np.float64)
    if native not in _SINGULAR or array.ndim != 2:
        raise FramesError(f"a phase map must be (H, W) float32 or float64, not {array.shape} {array.dtype}")
    return array.astype(native, copy=False)


def _check_distances(d_mm: float, delta_d_mm: float) -> None:
    if not d_mm > 0:
        raise MeasurementError(f"d_mm must be a positive distance from the reference to the glass, not {d_mm}")
    if delta_d_mm == 0:
        raise MeasurementError(
            f"delta_d_mm must be a travel other than 0 (positive: away from the glass), not {delta_d_mm}"
        )
    if d_mm + delta_d_mm <= 0:
        raise MeasurementError(f"delta_d_mm = {delta_d_mm} moves the reference through the glass at d_mm = {d_mm}")
