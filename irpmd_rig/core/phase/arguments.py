"""Fringe counts and frames as callers hand them in, refused with one typed error where they are none."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.arguments import is_listed, is_real
from irpmd_rig.core.errors import CountsError, FramesError

MOST_FRINGES = 16384
"""Largest fringe count: one for each column of the widest projector image."""


def fringe_counts(counts: object) -> npt.NDArray[np.float64]:
    """Return fringe counts as an array; raises CountsError unless all are numbers in 0..MOST_FRINGES, not 0."""
    if is_listed(counts) and len(counts) and all(is_real(c) and 0 < c <= MOST_FRINGES for c in counts):
        return np.array(counts, dtype=np.float64)
    raise CountsError(f"fringe counts must be positive numbers (above 0, at most {MOST_FRINGES}), got {counts!r}")


def frame_array(frames: npt.ArrayLike) -> npt.NDArray[Any]:
    """Frames as one array, not copied if they are one; raises FramesError for ragged and for masked ones."""
    if _masked(frames, 3):
        raise FramesError("frames hold masked values: fill them or drop the mask")
    try:
        return np.asarray(frames)
    except (TypeError, ValueError) as error:
        raise FramesError(f"frames must be one array (sets, steps, H, W): {error}") from error


def _masked(frames: object, depth: int) -> bool:
    """Whether frames, or lists of them down to a depth, hold a masked value."""
    if isinstance(frames, list | tuple):
        return depth > 0 and any(_masked(part, depth - 1) for part in frames)
    return bool(np.ma.is_masked(frames))
