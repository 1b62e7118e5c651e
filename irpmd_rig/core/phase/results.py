"""What decoding returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

_MOST_THIN = 256


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one pixel value in one frame: sigma_I^2 = floor_dn2 + slope_dn A, A the mean over the steps.

    The slope is shot noise, which all light brings, the floor everything else: of one camera the same whatever the
    contrast of the fringes, which a blur takes where they are fine.

    Attributes
    ----------
    floor_dn2, slope_dn
        As above.
    dark_dn, light
        How much light there typically is where the modulation is B: A = dark_dn + light B.
    """

    floor_dn2: float
    slope_dn: float
    dark_dn: float = 0.0
    light: float = 1.0

    def variance_dn2(self, mean_dn: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Variance of a pixel value at a mean, DN^2; same shape."""
        return np.float32(self.floor_dn2) + np.float32(self.slope_dn) * np.maximum(mean_dn, np.float32(0))

    def least_modulation_dn(self, sigmas: float) -> float:
        """Modulation B that is so many sigma_I of the light there is with it."""
        half = 0.5 * sigmas**2 * self.slope_dn * self.light
        return float(half + np.sqrt(half**2 + sigmas**2 * (self.floor_dn2 + self.slope_dn * self.dark_dn)))


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
    mean_dn
        float32 (h, w): mean A over the steps of the finest set at every `thinning`th row and column.
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
    mean_dn: npt.NDArray[np.float32]
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
        return phase_sigma(self.noise_dn, self.modulation_dn, window, self.valid[window])

    @property
    def noise_dn(self) -> npt.NDArray[np.float32]:
        """One sigma of the phase times the modulation, DN, of the pixels of `mean_dn`."""
        weight = 1.0
        if self.unwrapping == "optimum":
            weight = sum((count / max(self.counts)) ** 2 for count in self.counts)
        return np.float32(np.sqrt(2 / self.steps / weight)) * np.sqrt(self.noise.variance_dn2(self.mean_dn))


def thinning(height: int, width: int) -> int:
    """Rows and columns of a picture for one of its means: light changes little between them."""
    return max(1, max(height, width) // _MOST_THIN)


def phase_sigma(
    noise_dn: npt.NDArray[np.float32],
    modulation_dn: npt.NDArray[np.float32],
    window: tuple[slice, slice],
    wanted: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[np.float32]:
    """One sigma of the phase in a window of the picture, rad.

    Parameters
    ----------
    noise_dn
        As `AbsolutePhase.noise_dn`.
    modulation_dn
        float32 (H, W).
    window
        Rows and columns.
    wanted
        bool (h, w): where it is asked for, NaN elsewhere; all of the window by default.
    """
    stride = thinning(*modulation_dn.shape)
    rows, columns = (np.arange(size)[side] // stride for size, side in zip(modulation_dn.shape, window, strict=True))
    modulation = modulation_dn[window]
    sigma = np.empty(modulation.shape, np.float32)
    # Row by row of the noise, spread over its columns once for all pixels that share it.
    first = np.flatnonzero(np.diff(rows, prepend=-1))
    for begin, end in zip(first, [*first[1:], len(rows)], strict=True):
        band = slice(begin, end)
        with np.errstate(divide="ignore", invalid="ignore"):
            np.divide(noise_dn[rows[begin], columns], modulation[band], out=sigma[band])
        if wanted is not None:
            np.copyto(sigma[band], np.float32(np.nan), where=~wanted[band])
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
