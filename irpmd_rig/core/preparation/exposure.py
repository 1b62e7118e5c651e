"""Brightness against exposure time: what saturates, whether the camera is linear, and its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError

Floats = NDArray[np.float64]

BRIGHT_FRACTION = 0.85
"""Share of full scale that the brightest parts should reach."""

BRIGHT_PERCENTILE = 99.5
_LINEAR_FRACTION = 0.95
_BINS = 64
_FEWEST_IN_BIN = 200
_ROUNDING_DN2 = 1 / 12


@dataclass(frozen=True, slots=True, eq=False)
class ExposureCurve:
    """What a camera sees of one scene at several exposures; shares are of full scale.

    Attributes
    ----------
    exposures_us : ndarray, (n,)
        Exposure times.
    bright : ndarray, (n,)
        Value that 99.5 % of the pixels do not pass.
    saturated : ndarray, (n,)
        Share of the pixels at full scale.
    recommended_us : float
        Exposure at which `bright` is 85 %; NaN where it cannot be told from these.
    nonlinearity : float
        Largest deviation of the bright pixels' mean from a straight line over the exposures that do not saturate, as a
        share of the largest mean; NaN where fewer than three do not.
    noise_floor_dn : float
        One sigma of a pixel value without light; NaN where the noise cannot be told.
    shot_dn : float
        Growth of the variance with the value, DN: one over the electrons a DN, if all of it is shot noise.
    """

    exposures_us: Floats
    bright: Floats
    saturated: Floats
    recommended_us: float
    nonlinearity: float
    noise_floor_dn: float
    shot_dn: float


def exposure_curve(
    pairs: Sequence[tuple[NDArray[Any], NDArray[Any]]], exposures_us: Sequence[float], full_scale_dn: float
) -> ExposureCurve:
    """Compare pairs of frames of a scene that does not change, taken at rising exposures.

    Parameters
    ----------
    pairs : sequence of pairs of ndarray, (H, W)
        Two frames an exposure.
    exposures_us : sequence of float
        Rising exposure times.
    full_scale_dn : float
        Value at which a pixel is saturated.

    Returns
    -------
    ExposureCurve
        See there.

    Raises
    ------
    CalibrationError
        At the longest exposure nothing is lit, or the exposures do not rise.
    """
    times_us = np.asarray(exposures_us, dtype=np.float64)
    if times_us.size < 2 or np.any(np.diff(times_us) <= 0):
        raise CalibrationError(f"exposures must rise, and these are {times_us.tolist()} us: give others")
    bright = np.array([float(np.percentile(one, BRIGHT_PERCENTILE)) for one, _ in pairs]) / full_scale_dn
    saturated = np.array([float(np.mean(one >= full_scale_dn)) for one, _ in pairs])
    if bright[-1] <= 0.02:
        raise CalibrationError(
            f"nothing is lit at {times_us[-1]:g} us: check projector, lens and placement, or give longer exposures"
        )
    good = bright < _LINEAR_FRACTION
    floor, slope = _noise(pairs, full_scale_dn)
    return ExposureCurve(
        exposures_us=times_us,
        bright=bright,
        saturated=saturated,
        recommended_us=_recommended(times_us[good], bright[good]),
        nonlinearity=_nonlinearity(times_us[good], [one for (one, _), used in zip(pairs, good, strict=True) if used]),
        noise_floor_dn=float(np.sqrt(floor)) if floor >= 0 else float("nan"),
        shot_dn=slope,
    )


def _recommended(times_us: Floats, bright: Floats) -> float:
    if times_us.size == 0:
        return float("nan")
    if times_us.size == 1:
        return float(times_us[0] * BRIGHT_FRACTION / bright[0])
    # Brightness is a line in time, and the longest of the exposures tell it best.
    rise, offset = np.polyfit(times_us, bright, 1, w=times_us)
    return float((BRIGHT_FRACTION - offset) / rise) if rise > 0 else float("nan")


def _nonlinearity(times_us: Floats, frames: list[NDArray[Any]]) -> float:
    if times_us.size < 3:
        return float("nan")
    low, high = np.percentile(frames[-1], [80, 99])
    chosen = (frames[-1] >= low) & (frames[-1] <= high)
    means = np.array([float(frame[chosen].mean()) for frame in frames])
    line = np.polyfit(times_us, means, 1)
    return float(np.abs(means - np.polyval(line, times_us)).max() / means.max())


def _noise(pairs: Sequence[tuple[NDArray[Any], NDArray[Any]]], full_scale_dn: float) -> tuple[float, float]:
    """Variance without light, and its growth with the value, from what differs between two frames of a scene."""
    number, level, variance = np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS)
    for one, other in pairs:
        mean = 0.5 * (one.reshape(-1).astype(np.float64) + other.reshape(-1))
        half = 0.5 * (one.reshape(-1).astype(np.float64) - other.reshape(-1)) ** 2
        inside = mean < _LINEAR_FRACTION * full_scale_dn
        place = (mean[inside] * (_BINS / full_scale_dn)).astype(np.intp)
        number += np.bincount(place, minlength=_BINS)
        level += np.bincount(place, weights=mean[inside], minlength=_BINS)
        variance += np.bincount(place, weights=half[inside], minlength=_BINS)
    # In the lowest bin values are cut off at zero.
    filled = (number >= _FEWEST_IN_BIN) & (np.arange(_BINS) > 0)
    if np.count_nonzero(filled) < 3:
        return float("nan"), float("nan")
    level, variance = level[filled] / number[filled], variance[filled] / number[filled]
    weights = np.sqrt(number[filled]) / np.maximum(variance, 1e-6)
    slope, floor = np.polyfit(level, variance - _ROUNDING_DN2, 1, w=weights)
    return max(float(floor), 0.0), float(slope)
