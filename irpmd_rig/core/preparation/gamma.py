"""The projector's light against the level that it is told, and the levels that make it linear."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from irpmd_rig.core.errors import CalibrationError

Floats = NDArray[np.float64]

TOP_LEVEL = 254
"""Brightest level of a fringe (`irpmd_rig.core.fringe_images`)."""

FEWEST_STEPS = 12
"""Below this the harmonics of a strong gamma fall onto the fundamental, which scales every pixel."""

_DEGREE = 7
_SAMPLED_PX = 100_000
_FEWEST_PX = 500
_LEVELS = np.arange(256)


@dataclass(frozen=True, slots=True, eq=False)
class GammaResponse:
    """How the light that the camera sees follows the level.

    Attributes
    ----------
    levels : ndarray, (n,)
        Levels that were seen, 0 to 254.
    light : ndarray, (n,)
        Light at these, from 0 at level 0 to 1 at level 254 of the smooth curve.
    sigma : ndarray, (n,)
        One sigma of `light`, from the scatter among pixels.
    gamma, sigma_gamma : float
        Exponent of ``light = (level / 254)^gamma`` that fits best, and one sigma.
    rms : float
        What is left of the smooth curve against that law, as a share of full light.
    table : ndarray of uint8, (256,)
        Level to show in place of each level, so that the light is linear.
    pixels : int
        Pixels used.
    """

    levels: Floats
    light: Floats
    sigma: Floats
    gamma: float
    sigma_gamma: float
    rms: float
    table: NDArray[np.uint8]
    pixels: int


def measure_gamma(
    frames: NDArray[np.generic], counts: Sequence[float], phase_rad: NDArray[np.floating]
) -> GammaResponse:
    """Find the response from wide fringes in many steps.

    Parameters
    ----------
    frames : ndarray, (sets, steps, H, W)
        Camera frames of the fringes; step n is shifted by ``+2 pi n / steps``. The camera must be linear.
    counts : sequence of float
        Fringe count of each set.
    phase_rad : ndarray, (H, W)
        Absolute phase of the set with the largest count; NaN where not known.

    Returns
    -------
    GammaResponse
        See there.

    Raises
    ------
    CalibrationError
        Fewer than 12 steps, too few pixels, or light that does not grow with the level.

    Notes
    -----
    What a pixel sees is affine in the projector's light: reflectance and ambient light differ from pixel to pixel, the
    curve does not. The mean over a whole period of steps and the amplitude of its fundamental depend on neither the
    pixel's phase nor (from 12 steps on) the harmonics, so that (I - mean) / amplitude is the same curve everywhere.
    """
    steps = frames.shape[1]
    if steps < FEWEST_STEPS:
        raise CalibrationError(f"a gamma needs fringes in at least {FEWEST_STEPS} steps, and these have {steps}")
    known = np.flatnonzero(np.isfinite(phase_rad))
    if known.size < _FEWEST_PX:
        raise CalibrationError(
            f"a gamma needs {_FEWEST_PX} pixels that see fringes at least, and {known.size} do: check light and object"
        )
    chosen = known[:: max(1, known.size // _SAMPLED_PX)]
    phase = phase_rad.reshape(-1)[chosen].astype(np.float64)
    sums = np.zeros((3, 256))
    for taken, count in zip(frames, counts, strict=True):
        values = taken.reshape(steps, -1)[:, chosen].astype(np.float64)
        sums += _summed(values, phase * count / max(counts))
    seen = sums[0] > 0
    light = sums[1, seen] / sums[0, seen]
    # Weights are squared amplitudes: the scatter of the mean follows from the second moment.
    spread = np.maximum(sums[2, seen] / sums[0, seen] - light**2, 0.0)
    pixels_a_level = np.maximum(sums[0, seen] / sums[0].max() * chosen.size * steps * len(counts) / 256, 1.0)
    return _response(_LEVELS[seen].astype(np.float64), light, np.sqrt(spread / pixels_a_level), chosen.size)


def _summed(values: Floats, angle: Floats) -> Floats:
    """Weight, weighted light and its square of each level, (3, 256)."""
    steps = values.shape[0]
    shifts = 2 * np.pi * np.arange(steps)[:, None] / steps
    mean = values.mean(axis=0)
    amplitude = np.hypot((values * np.cos(shifts)).sum(axis=0), (values * np.sin(shifts)).sum(axis=0)) * 2 / steps
    level = np.rint(0.5 * TOP_LEVEL * (1 + np.cos(angle + shifts))).astype(np.intp)
    light = (values - mean) / np.maximum(amplitude, 1e-9)
    weight = np.broadcast_to(amplitude**2, level.shape)
    return np.stack(
        [
            np.bincount(level.reshape(-1), weights=(weight * power).reshape(-1), minlength=256)
            for power in (np.ones_like(light), light, light**2)
        ]
    )


def _response(levels: Floats, light: Floats, sigma: Floats, pixels: int) -> GammaResponse:
    share = levels / TOP_LEVEL
    # Levels near both ends are those that a cosine stays at: they are seen most and weigh most.
    weights = 1 / np.maximum(sigma, np.median(sigma))
    smooth = np.polynomial.Chebyshev.fit(share, light, _DEGREE, domain=[0, 1], w=weights)
    every = np.arange(TOP_LEVEL + 1) / TOP_LEVEL
    curve = smooth(every)
    black, full = curve[0], curve[-1] - curve[0]
    if full <= 0 or np.any(np.diff(curve) < -1e-3 * full):
        raise CalibrationError(
            "the light does not grow with the level everywhere: check that nothing saturates, that the light is steady "
            "and that the fringes are wide"
        )
    light, sigma, curve = (light - black) / full, sigma / full, (curve - black) / full

    def misfit(parameters: Floats) -> Floats:
        offset, scale, gamma = parameters
        return np.asarray((offset + scale * share**gamma - light) * weights * full)

    law = least_squares(misfit, (0.0, 1.0, 1.0), bounds=((-1, 0, 0.1), (1, 3, 10)))
    covariance = np.linalg.inv(law.jac.T @ law.jac) * 2 * law.cost / max(levels.size - 3, 1)
    offset, scale, gamma = law.x
    return GammaResponse(
        levels=levels,
        light=light,
        sigma=sigma,
        gamma=float(gamma),
        sigma_gamma=float(np.sqrt(covariance[2, 2])),
        rms=float(np.sqrt(np.mean((offset + scale * every**gamma - curve) ** 2))),
        table=_table(np.maximum.accumulate(curve)),
        pixels=pixels,
    )


def _table(curve: Floats) -> NDArray[np.uint8]:
    """Levels by which a curve (255,) from 0 to 1 becomes a straight line; 255 stays what it is."""
    wanted = np.arange(TOP_LEVEL + 1) / TOP_LEVEL
    # Where the smooth curve is level by a rounding, the first of equal levels is as good as any.
    rising, first = np.unique(curve, return_index=True)
    table = np.arange(256, dtype=np.uint8)
    table[: TOP_LEVEL + 1] = np.rint(np.interp(wanted, rising, first)).astype(np.uint8)
    return table
