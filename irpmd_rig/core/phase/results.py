"""What decoding returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

_BAND_ROWS = 32


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one pixel value in one frame: sigma_I^2 = floor_dn2 + slope_dn B, B the modulation.

    The slope is shot noise (the light that carries the fringes grows with B), the floor everything else.
    """

    floor_dn2: float
    slope_dn: float

    def variance_dn2(self, modulation_dn: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Variance of a pixel value at a modulation, DN^2; same shape."""
        return np.float32(self.floor_dn2) + np.float32(self.slope_dn) * modulation_dn

    def least_modulation_dn(self, sigmas: float) -> float:
        """Modulation B that is so many sigma_I(B): the root of B^2 = sigmas^2 (floor + slope B)."""
        half = 0.5 * sigmas**2 * self.slope_dn
        return float(half + np.sqrt(half**2 + sigmas**2 * self.floor_dn2))


@dataclass(frozen=True, slots=True, eq=False)
class AbsolutePhase:
    """Absolute phase of every pixel, as `decode` returns it.

    Attributes
    ----------
    phase_rad
        float32 (H, W): absolute phase of the finest set (the largest count); NaN where not valid.
    modulation_dn
        float32 (H, W): mean of the sets' modulations B, in the units of the frames (of the linear values, if
        a camera response was applied); also where not valid.
    valid
        bool (H, W): enough modulation in every set, no saturated step, fringe orders that agree.
    counts
        Fringe counts in the order of the frames.
    steps
        Phase steps N of each set.
    unwrapping
        The method that found the orders; it also says which sets the phase is the mean of.
    noise
        Noise of one pixel value, estimated from the frames' own redundancy.
    least_modulation_dn
        The threshold on B that was applied.
    """

    phase_rad: npt.NDArray[np.float32]
    modulation_dn: npt.NDArray[np.float32]
    valid: npt.NDArray[np.bool_]
    counts: tuple[float, ...]
    steps: int
    unwrapping: Literal["optimum", "hierarchical"]
    noise: NoiseModel
    least_modulation_dn: float

    @property
    def sigma_rad(self) -> npt.NDArray[np.float32]:
        """One sigma of ``phase_rad``, float32 (H, W), NaN where not valid; computed at each call.

        sqrt(2 / N) sigma_I / B for one set (physics notes, section 3), divided by sqrt(sum (c_k / c_0)^2) for
        the noise-weighted mean of the optimum method. Random noise only: neither gamma nor the
        rounding of the projected pattern is in it.
        """
        return self.sigma_in((slice(None), slice(None)))

    def sigma_in(self, window: tuple[slice, slice]) -> npt.NDArray[np.float32]:
        """Return `sigma_rad` in a window of rows and columns alone, (h, w)."""
        weight = 1.0
        if self.unwrapping == "optimum":
            weight = sum((count / max(self.counts)) ** 2 for count in self.counts)
        scale = np.float32(np.sqrt(2 / self.steps / weight))
        modulation, valid = self.modulation_dn[window], self.valid[window]
        sigma = np.full(valid.shape, np.nan, np.float32)
        # In bands, whose intermediate results stay in the cache.
        for first in range(0, len(sigma), _BAND_ROWS):
            rows = slice(first, first + _BAND_ROWS)
            variance = self.noise.variance_dn2(modulation[rows])
            deviation = np.sqrt(variance, out=variance)
            deviation *= scale
            np.divide(deviation, modulation[rows], out=sigma[rows], where=valid[rows])
        return sigma


@dataclass(frozen=True, slots=True, eq=False)
class WrappedPhases:
    """Phase of every set by itself, as `wrapped_phases` returns it.

    Attributes
    ----------
    phase_rad
        float32 (sets, H, W) in (-pi, pi]; NaN where there is no modulation at all.
    modulation_dn
        float32 (sets, H, W): B, half the swing of the fringes.
    mean_dn
        float32 (sets, H, W): A, the mean over the steps.
    """

    phase_rad: npt.NDArray[np.float32]
    modulation_dn: npt.NDArray[np.float32]
    mean_dn: npt.NDArray[np.float32]
