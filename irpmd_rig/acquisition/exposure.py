"""Automatic exposure: measured, bounded, and told."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers.protocols import Frame
from irpmd_rig.core.errors import FramesError

BRIGHT_FRACTION = 0.85
"""Of full scale, for the brightest parts of a frame."""

START_US = 5000.0
_BRIGHT_PERCENTILE = 99.5
_DARK_FRACTION = 0.02
# From here on one proportional correction is exact enough: a camera of gamma 1 is linear.
_NEAR_FRACTION = 0.4
_TRIES = 8
_SAMPLED_PX = 512


def brightness(frame: Frame) -> float:
    """Value of the brightest parts of a frame (99.5 % of its pixels are no brighter), as a share of full scale."""
    stride = max(1, min(frame.image.shape[:2]) // _SAMPLED_PX)
    sample = frame.image[::stride, ::stride]
    return float(np.percentile(sample, _BRIGHT_PERCENTILE) / (2**frame.bits - 1))


def measure_exposure_us(shoot: Callable[[float], Frame], start_us: float, range_us: tuple[float, float]) -> float:
    """Find the exposure at which the brightest parts reach 85 % of full scale.

    Parameters
    ----------
    shoot
        Takes a frame with an exposure in microseconds.
    start_us
        Where to begin; near the right one, a single frame is taken.
    range_us
        Shortest and longest exposure that may be chosen.

    Returns
    -------
    float
        The exposure in microseconds: the longest where not even that reaches 85 %.

    Raises
    ------
    FramesError
        Nothing is lit, everything is overexposed, or the light is not steady enough to settle on an exposure.
    """
    shortest_us, longest_us = range_us
    exposure_us = min(max(start_us, shortest_us), longest_us)
    for _ in range(_TRIES):
        bright = brightness(shoot(exposure_us))
        if bright >= 1.0:
            if exposure_us <= shortest_us:
                raise FramesError(
                    f"the camera sees full scale even at {exposure_us:g} us: dim the light, close the lens"
                )
            # By how much it is too bright cannot be seen.
            exposure_us = max(exposure_us / 4, shortest_us)
            continue
        wanted_us = longest_us if bright <= 0.0 else exposure_us * BRIGHT_FRACTION / bright
        wanted_us = min(max(wanted_us, shortest_us), longest_us)
        if exposure_us >= longest_us and bright < _DARK_FRACTION:
            raise FramesError(
                f"nothing in the camera's view is lit at {exposure_us:g} us: check projector, glass and placement"
            )
        if bright >= _NEAR_FRACTION or exposure_us >= longest_us:
            return wanted_us
        exposure_us = wanted_us
    raise FramesError(f"no exposure was found in {_TRIES} frames: the light is not steady")
