"""Checks of single arguments: one typed error that names the argument."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import TypeGuard

import numpy as np

from irpmd_rig.core.errors import MeasurementError

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


def finite_number(name: str, value: object) -> float:
    """Return a value as a float; raises MeasurementError unless it is a finite real number."""
    if not is_real(value) or not np.isfinite(value):
        raise MeasurementError(f"{name} must be a finite number, not {value!r}")
    return float(value)


def whole_number(name: str, value: object, *, least: int) -> int:
    """Return a value as an int; raises MeasurementError unless it is a whole number of at least ``least``."""
    if not is_integer(value) or value < least:
        raise MeasurementError(f"{name} must be a whole number of at least {least}, not {value!r}")
    return int(value)
