"""Fringe images: what the projector is told to show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.arguments import is_integer, is_listed
from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.phase.arguments import fringe_counts

_TOP = 254
"""Brightest value shown: one short of 255, so that the images themselves decode without saturated pixels."""

_MOST_STEPS = 1000
_MOST_PX = 16384
_MOST_BYTES = 2**32


def fringe_images(
    counts: Sequence[float] = (64, 63, 56),
    steps: int = 4,
    size_px: tuple[int, int] = (1024, 768),
    axis: Literal["x", "y"] = "x",
    bits: int = 8,
) -> npt.NDArray[np.uint8]:
    """Sinusoidal fringes of several counts, each shifted in equal phase steps.

    The phase at column x (pixel centres at integers) is ``2 pi count (x + 0.5) / W``; step n adds
    ``2 pi n / steps``; the value shown is ``127 + 127 cos(phase)``, rounded to the nearest level.

    Parameters
    ----------
    counts
        Periods across the projector, one set of images each; any real numbers > 0, at most 16384.
    steps
        Phase steps of each set, 3 to 1000.
    size_px
        Width and height of the images in projector pixels, each 1 to 16384; all images together at most 4 GiB.
    axis
        ``"x"``: the phase grows along the columns; ``"y"``: along the rows, with H in place of W.
    bits
        1 to 8. Fewer bits show fewer levels (a DMD with fewer bit planes), spread over the same 0..254.

    Returns
    -------
    uint8 array (sets, steps, H, W)

    Raises
    ------
    CountsError
        No counts, or one that is not a number above 0 and at most 16384.
    FramesError
        An impossible number of steps, size, axis or number of bits; images of more than 4 GiB.

    Notes
    -----
    The paper, eq. (1). The rounding shifts the decoded phase coherently where the fringe period is a few
    pixels (physics notes, section 4): it is part of what is shown, not of what is decoded.
    """
    periods = fringe_counts(counts)
    _check_images(steps, size_px, axis, bits)
    width, height = (int(n) for n in size_px)
    shape = (periods.size, int(steps), height, width)
    if math.prod(shape) > _MOST_BYTES:
        raise FramesError(f"images of shape {shape} would be larger than 4 GiB")
    length = width if axis == "x" else height
    position = (np.arange(length) + 0.5) / length
    shifts = np.arange(steps) / steps
    levels = min(2**bits - 1, _TOP)
    images = np.empty(shape, np.uint8)
    for image_set, period in zip(images, periods, strict=True):
        turns = period * position + shifts[:, None]
        level = np.rint((0.5 + 0.5 * np.cos(2 * np.pi * turns)) * levels)
        profile = np.rint(level * (_TOP / levels))
        image_set[...] = profile[:, None, :] if axis == "x" else profile[:, :, None]
    return images


def _check_images(steps: object, size_px: object, axis: object, bits: object) -> None:
    if not is_integer(steps) or not 3 <= steps <= _MOST_STEPS:
        raise FramesError(f"steps must be an integer of at least 3 and at most {_MOST_STEPS}, got {steps!r}")
    if not is_listed(size_px) or len(size_px) != 2 or not all(is_integer(n) and 1 <= n <= _MOST_PX for n in size_px):
        raise FramesError(f"size_px must be (width, height) in whole pixels, 1 to {_MOST_PX}, got {size_px!r}")
    if not isinstance(axis, str) or axis not in ("x", "y"):
        raise FramesError(f"axis must be 'x' or 'y', got {axis!r}")
    if not is_integer(bits) or not 1 <= bits <= 8:
        raise FramesError(f"bits must be an integer from 1 to 8, got {bits!r}")
