"""Which part of the picture shows what: found by taking things away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_LIT_FRACTION = 0.2  # of the brightest parts: what counts as lit
_EDGE_PX = 6
_RIM = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1))
_SQUARE = np.ones((5, 5), np.uint8)

Mask = NDArray[np.bool_]
Window = tuple[slice, slice]


def lit(white: NDArray[Any], black: NDArray[Any]) -> Mask:
    """Pixels that the projector lights.

    Parameters
    ----------
    white, black : ndarray, (H, W)
        Frames under full light and without light.

    Returns
    -------
    ndarray of bool, (H, W)
        Specks left out.
    """
    difference = white.astype(np.float32) - black.astype(np.float32)
    threshold = _LIT_FRACTION * float(np.percentile(difference, 99))
    return np.asarray(ndimage.binary_opening(difference > threshold, iterations=2))


def grow(region: Mask) -> Mask:
    """A region with a rim added."""
    grown = np.zeros_like(region)
    box = bounding_box(region)
    if box is not None:
        around = tuple(slice(max(part.start - _EDGE_PX, 0), part.stop + _EDGE_PX) for part in box)
        grown[around] = cv2.dilate(region[around].astype(np.uint8), _RIM)
    return grown


def shrink(region: Mask) -> Mask:
    """A region without its rim, where two surfaces share a pixel."""
    shrunk = np.zeros_like(region)
    box = bounding_box(region)
    if box is not None:
        # Outside the picture nothing is known: its edge is a rim, too.
        shrunk[box] = cv2.erode(region[box].astype(np.uint8), _RIM, borderValue=0)
    return shrunk


def solid(region: Mask) -> Mask:
    """A region without its small holes and specks: pixels that noise spoils part no surface."""
    closed = cv2.morphologyEx(region.astype(np.uint8), cv2.MORPH_CLOSE, _SQUARE)
    return np.asarray(cv2.morphologyEx(closed, cv2.MORPH_OPEN, _SQUARE), dtype=np.bool_)


def bounding_box(known: Mask) -> Window | None:
    """Rows and columns that hold every True; None where there is none."""
    rows, columns = np.nonzero(known.any(axis=1))[0], np.nonzero(known.any(axis=0))[0]
    if rows.size == 0:
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def inside(window: Window, outer: Window) -> Window:
    """Give the rows and columns of the picture that a window has which is counted from a larger one's first."""
    rows, columns = (slice(w.start + o.start, w.stop + o.start) for w, o in zip(window, outer, strict=True))
    return rows, columns


def common(windows: Sequence[Window]) -> Window:
    """Give the rows and columns that all windows share; raises ValueError if they share none."""
    rows, columns = (slice(max(w[axis].start for w in windows), min(w[axis].stop for w in windows)) for axis in (0, 1))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        raise ValueError("what is seen at one position is not seen at another")
    return rows, columns


def overlap(one: Window, other: Window) -> Window:
    """Give the rows and columns that two windows share, none where they share none."""
    rows, columns = (
        slice(max(a.start, b.start), max(max(a.start, b.start), min(a.stop, b.stop)))
        for a, b in zip(one, other, strict=True)
    )
    return rows, columns


def within(window: Window, outer: Window) -> Window:
    """Give the rows and columns of a window inside a larger one, counted from that one's first."""
    rows, columns = (slice(w.start - o.start, w.stop - o.start) for w, o in zip(window, outer, strict=True))
    return rows, columns
