"""The pattern error: what the rounding of the fringe images to 8 bits adds to the decoded phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from scipy.special import ndtr

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.arguments import checked_number
from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.fringes import fringe_images
from irpmd_rig.core.phase._wide_vectors import wide_vectors
from irpmd_rig.core.phase.counts import checked_counts, ladder

Floats = NDArray[np.float32]
Phase = TypeVar("Phase", NDArray[np.float32], NDArray[np.float64])

TYPICAL_BLUR_PX = 0.6
"""Blur of the light between DMD and camera: a projector lens of half a pixel, and some of a camera's own."""

_SAMPLES = 8  # of a projector pixel: a straight line between two is wrong by less than 1e-5 rad
_REACH_SIGMAS = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class PatternError:
    """Error of the absolute phase as a function of it, as `pattern_error` computes it.

    Attributes
    ----------
    error_rad
        float32 (n,): decoded minus true phase at `n` equally spaced phases from 0 to ``2 pi count``.
    count
        Fringe count of the finest set, to which absolute phases belong.
    """

    error_rad: Floats
    count: float
    _scale: np.float32 = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_scale", np.float32((self.error_rad.size - 1) / (2 * np.pi * self.count)))

    def remove(self, phase_rad: Phase) -> Phase:
        """Subtract the error from decoded phases, in place.

        Parameters
        ----------
        phase_rad
            float32 or float64 of any shape, C-contiguous and writeable; NaN stays NaN.

        Returns
        -------
        ndarray
            ``phase_rad`` itself.

        Raises
        ------
        FramesError
            Phases of another type or layout.
        """
        if phase_rad.dtype not in (np.float32, np.float64) or not phase_rad.flags.carray:
            raise FramesError(
                f"phases must be float32 or float64, C-contiguous and writeable, got {phase_rad.dtype} "
                f"with strides {phase_rad.strides}"
            )
        _subtract(phase_rad.reshape(-1), self.error_rad, self._scale)
        return phase_rad


def pattern_error(
    counts: Sequence[float],
    steps: int,
    width_px: int,
    *,
    unwrapping: Literal["optimum", "hierarchical"] = "optimum",
    blur_px: float = TYPICAL_BLUR_PX,
) -> PatternError:
    """Compute the phase error of the images that `irpmd_rig.core.fringe_images` makes.

    Parameters
    ----------
    counts, steps
        Of the fringe images; ``counts`` as `irpmd_rig.core.decode` takes them.
    width_px
        Columns of the projector; its rows for fringes along y.
    unwrapping
        As the frames are decoded: it says of which sets the absolute phase is the mean.
    blur_px
        Standard deviation of the blur of the light on its way to a camera's pixel, projector pixels.

    Raises
    ------
    CountsError, FramesError
        Counts, steps or a width of which there are no fringe images, or counts that the method cannot use.
    MeasurementError
        A blur that is no number above 0.

    Notes
    -----
    Physics notes, sections 4 and 5. A DMD shows whole grey levels on square pixels. The rounding is the same in every
    period where the period is a whole number of pixels (16 of them at 64 fringes), so that it does not average out:
    it is a ripple of up to 15 um of height at four steps. The images are known, so is the light behind pixel and lens,
    and with it what the arithmetic of the phase makes of it. Of a projector whose response is not linear the ripple
    is slightly another one; that, and the response's own harmonics, are not in it.
    """
    images = fringe_images(counts, steps, (width_px, 1))[:, :, 0, :]
    periods = checked_counts(counts, len(images))
    rungs = ladder(periods, unwrapping)
    light = _behind_the_lens(images, checked_number("blur_px", blur_px, zero=False))
    position = np.arange(light.shape[-1]) / (light.shape[-1] - 1)
    turns = np.array(periods)[:, None] * position
    # Step n adds 2 pi n / N: its light is A + B cos(phase + 2 pi n / N).
    wave = np.exp(-2j * np.pi * np.arange(steps) / steps)
    errors = np.angle(np.einsum("n,kni->ki", wave, light) * np.exp(-2j * np.pi * turns))
    finest = max(periods)
    if unwrapping == "hierarchical":
        error = errors[rungs.sets[-1]]
    else:
        # The mean of (c0 / ck) phase_k with weights ck^2, as decoded.
        error = finest * np.dot(periods, errors) / np.dot(periods, periods)
    return PatternError(error.astype(np.float32), finest)


def _behind_the_lens(images: NDArray[np.uint8], blur_px: float) -> NDArray[np.float64]:
    """Light of images (sets, steps, W) at W * _SAMPLES + 1 places from the left edge of the DMD to its right edge.

    Every pixel is a uniform square, blurred by a Gaussian; beyond the DMD there is no light.
    """
    sets, steps, width = images.shape
    reach = math.ceil(0.5 + _REACH_SIGMAS * blur_px)
    offsets = np.arange(-reach, reach + 1)
    padded = np.pad(images.astype(np.float64), ((0, 0), (0, 0), (0, 1)))
    light = np.empty((sets, steps, width + 1, _SAMPLES))
    for sample in range(_SAMPLES):
        away = sample / _SAMPLES - 0.5 - offsets
        weights = ndtr((away + 0.5) / blur_px) - ndtr((away - 0.5) / blur_px)
        light[..., sample] = correlate1d(padded, weights, axis=-1, mode="constant")
    return light.reshape(sets, steps, -1)[..., : width * _SAMPLES + 1]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _subtract(phase: NDArray[Any], error: Floats, scale: np.float32) -> None:
    """Subtract a table's value, linear between its samples; beyond its ends theirs holds."""
    wide_vectors()
    last = np.float32(error.size - 1)
    for i in range(np.uintp(phase.size)):
        value = phase[i]
        place = np.float32(value) * scale
        # NaN goes to the first sample, and stays NaN below.
        place = min(place, last) if place > np.float32(0) else np.float32(0)
        left = min(np.uint32(place), np.uint32(error.size - 2))
        part = place - np.float32(left)
        phase[i] = value - (error[left] + part * (error[left + np.uint32(1)] - error[left]))


announce_compilation(_subtract, "the kernel of the pattern error")
