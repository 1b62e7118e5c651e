"""Where a surface is smooth: regions without a jump of the phase between neighbouring pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.reconstruction.views import Views

# A step or an edge makes the phase jump by radians (2 h tan(theta) or 2 d dslope on the glass); what a smooth surface
# leaves in this difference is its third derivative.
_SIGMAS = 8.0
_LEAST_JUMP_RAD = 0.02
_FEWEST_PIXELS = 30


def smooth_regions(views: Views) -> NDArray[np.int32]:
    """Connected pixels whose phases go on smoothly in all views.

    Parameters
    ----------
    views : Views
        Phases of the object.

    Returns
    -------
    ndarray of int32, (h, w)
        Number of the region, from 1; 0 where a phase is unknown, next to a jump, and in regions of under 30 pixels.

    Notes
    -----
    Looked at is how far a difference of neighbours departs from the mean of the differences beside it,
    (phi[i+1] - phi[i]) - (phi[i+2] - phi[i+1] + phi[i] - phi[i-1]) / 2, along rows and columns; its standard
    deviation is 2.24 times that of a phase, and eight of its sigmas count as a jump (a step of 0.2 mm, an edge of
    0.04 deg in the paper's rig).
    """
    smooth = np.logical_and.reduce([np.isfinite(phase) for phase in views.phases_rad])
    jump = np.zeros(views.shape, np.bool_)
    for phase, sigma in zip(views.phases_rad, views.sigmas_rad, strict=True):
        typical = float(np.median(sigma[smooth])) if smooth.any() else 0.0
        limit = max(_SIGMAS * np.sqrt(5.0) * typical, _LEAST_JUMP_RAD)
        jump |= _jumps(phase, limit) | _jumps(phase.T, limit).T
    smooth &= ~jump
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(smooth.astype(np.uint8), connectivity=4)
    kept = statistics[:, cv2.CC_STAT_AREA] >= _FEWEST_PIXELS
    kept[0] = False
    renumbered = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return np.asarray(renumbered[labels])


def _jumps(phase: NDArray[np.floating[Any]], limit: float) -> NDArray[np.bool_]:
    """Both pixels of every pair along a row between which the phase jumps."""
    jump = np.zeros(phase.shape, np.bool_)
    if phase.shape[1] < 4:
        return jump
    change = np.diff(phase, axis=1)
    departs = np.abs(change[:, 1:-1] - (change[:, :-2] + change[:, 2:]) / 2) > limit
    jump[:, 1:-2] |= departs
    jump[:, 2:-1] |= departs
    return jump
