"""Fringe images: what the projector is told to show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.errors import CountsError, FramesError

_TOP = 254
"""Brightest value shown: one short of 255, so that the images themselves decode without saturated pixels."""


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
        Periods across the projector, one set of images each; any real numbers > 0.
    steps
        Phase steps of each set, at least 3.
    size_px
        Width and height of the images in projector pixels.
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
        No counts, or one that is not a finite number above zero.
    FramesError
        Fewer than 3 steps, an impossible size, axis or number of bits.

    Notes
    -----
    The paper, eq. (1). The rounding shifts the decoded phase coherently where the fringe period is a few
    pixels (physics notes, section 4): it is part of what is shown, not of what is decoded.
    """
    periods = np.asarray(counts, dtype=np.float64)
    if periods.ndim != 1 or periods.size == 0 or not np.all(np.isfinite(periods) & (periods > 0)):
        raise CountsError(f"fringe counts must be finite numbers above 0, got {counts!r}")
    _check_images(steps, size_px, axis, bits)
    width, height = size_px
    length = width if axis == "x" else height
    position = (np.arange(length) + 0.5) / length
    shifts = np.arange(steps) / steps
    turns = periods[:, None, None] * position + shifts[:, None]
    levels = min(2**bits - 1, _TOP)
    level = np.rint((0.5 + 0.5 * np.cos(2 * np.pi * turns)) * levels)
    profile = np.rint(level * (_TOP / levels)).astype(np.uint8)
    stretched = profile[:, :, None, :] if axis == "x" else profile[:, :, :, None]
    return np.ascontiguousarray(np.broadcast_to(stretched, (periods.size, steps, height, width)))


def _check_images(steps: int, size_px: tuple[int, int], axis: str, bits: int) -> None:
    if not _is_integer(steps) or steps < 3:
        raise FramesError(f"steps must be an integer of at least 3, got {steps!r}")
    if len(size_px) != 2 or not all(_is_integer(n) and n >= 1 for n in size_px):
        raise FramesError(f"size_px must be (width, height) in whole pixels of at least 1, got {size_px!r}")
    if axis not in ("x", "y"):
        raise FramesError(f"axis must be 'x' or 'y', got {axis!r}")
    if not _is_integer(bits) or not 1 <= bits <= 8:
        raise FramesError(f"bits must be an integer from 1 to 8, got {bits!r}")


def _is_integer(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)
