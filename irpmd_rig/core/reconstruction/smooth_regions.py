"""Where a surface is smooth: regions without a jump of the phase between neighbouring pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.phase._wide_vectors import wide_vectors
from irpmd_rig.core.reconstruction.views import Views

# A step or an edge makes the phase jump by radians (2 h tan(theta) or 2 d dslope on the glass); what a smooth surface
# leaves in this difference is its third derivative.
_SIGMAS = 8.0
_LEAST_JUMP_RAD = 0.02
_FEWEST_PIXELS = 30
# Pixels from which a typical sigma is taken.
_SAMPLES = 4096


def smooth_regions(views: Views) -> NDArray[np.int32]:
    """Connected pixels that the same views know, two or more, and whose phases go on smoothly in all of them.

    Parameters
    ----------
    views : Views
        Phases of the object.

    Returns
    -------
    ndarray of int32, (h, w)
        Number of the region, from 1; 0 where fewer than two phases are known, next to a jump, and in regions of under
        30 pixels.

    Notes
    -----
    Looked at is how far a difference of neighbours departs from the mean of the differences beside it,
    (phi[i+1] - phi[i]) - (phi[i+2] - phi[i+1] + phi[i] - phi[i-1]) / 2, along rows and columns; its standard
    deviation is 2.24 times that of a phase, and eight of its sigmas count as a jump (a step of 0.2 mm, an edge of
    0.04 deg in the paper's rig).
    """
    seen = [np.isfinite(phase) for phase in views.phases_rad]
    smooth = (np.add.reduce(seen, dtype=np.uint8) > 1).astype(np.uint8)
    jump = np.zeros(views.shape, np.uint8)
    for where in seen if len(seen) > 2 else ():
        _mark_ends(where, jump)
    for phase, sigma, where in zip(views.phases_rad, views.sigmas_rad, seen, strict=True):
        known = sigma[where & (smooth > 0)]
        typical = float(np.median(known[:: max(1, known.size // _SAMPLES)])) if known.size else 0.0
        limit = max(_SIGMAS * np.sqrt(5.0) * typical, _LEAST_JUMP_RAD)
        _mark_jumps(phase, phase.dtype.type(limit), jump)
    smooth[jump > 0] = 0
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(smooth, connectivity=4)
    kept = statistics[:, cv2.CC_STAT_AREA] >= _FEWEST_PIXELS
    kept[0] = False
    renumbered = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return np.asarray(renumbered[labels])


def _mark_ends(known: NDArray[np.bool_], jump: NDArray[np.uint8]) -> None:
    """Mark both pixels of every pair of which a view knows one only."""
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        ends = known[one] != known[other]
        jump[one] |= ends
        jump[other] |= ends


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_jumps(phase: NDArray[Any], limit: Any, jump: NDArray[np.uint8]) -> None:
    """Mark both pixels of every pair, along rows and columns, between which the phase jumps."""
    height, width = phase.shape
    pair = np.zeros(width, np.uint8)
    for row in range(height):
        if width > 3:
            here = phase[row]
            _depart(here[:-3], here[1:-2], here[2:-1], here[3:], limit, pair)
            _mark(pair[: width - 3], jump[row, 1:-2])
            _mark(pair[: width - 3], jump[row, 2:-1])
        if 0 < row < height - 2:
            _depart(phase[row - 1], phase[row], phase[row + 1], phase[row + 2], limit, pair)
            _mark(pair, jump[row])
            _mark(pair, jump[row + 1])


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _depart(a: Any, b: Any, c: Any, d: Any, limit: Any, pair: Any) -> None:
    """Whether the change from b to c departs from the mean of the changes beside it."""
    wide_vectors()
    for i in range(np.uintp(a.size)):
        # Three times the middle change less the whole: twice the departure.
        twice = (c[i] - b[i]) - (d[i] - c[i]) + (c[i] - b[i]) - (b[i] - a[i])
        pair[i] = abs(twice) > limit + limit


@njit(nogil=True, error_model="numpy")
def _mark(pair: Any, jump: Any) -> None:
    wide_vectors()
    for i in range(np.uintp(pair.size)):
        jump[i] |= pair[i]


announce_compilation(_mark_jumps, "the search for edges")
