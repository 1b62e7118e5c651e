"""What callers hand in: numbers, fringe counts and frames, refused with one typed error where they are none."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.errors import CountsError, FramesError, MeasurementError

MOST_FRINGES = 16384
"""Largest fringe count: one for each column of the widest projector image."""

BEYOND = 1e30
"""Values and thresholds of this size would overflow float32 in the arithmetic."""


def is_integer(value: object) -> TypeGuard[int]:
    """Whether a value is a whole number by type; a bool is none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def is_real(value: object) -> TypeGuard[float]:
    """Whether a value is a real number by type; a bool is none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def is_listed(value: object) -> TypeGuard[Sequence[object]]:
    """Whether a value has elements in an order."""
    return isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim > 0)


def checked_number(name: str, value: object, *, zero: bool = True) -> float:
    """Return a threshold as a float; raises MeasurementError unless it is finite and above zero (or zero)."""
    if not is_real(value) or not 0 <= value < BEYOND or (value == 0 and not zero):
        least = "of at least 0" if zero else "above 0"
        raise MeasurementError(f"{name} must be a number {least} and below {BEYOND:g}, got {value!r}")
    return float(value)


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
