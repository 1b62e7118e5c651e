"""Checks of single arguments: one typed error that names the argument."""

from __future__ import annotations

import numbers

import numpy as np

from irpmd_rig.core.errors import MeasurementError


def finite_number(name: str, value: object) -> float:
    """The value as a float.

    Raises
    ------
    MeasurementError
        If it is no finite real number.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not np.isfinite(float(value)):
        raise MeasurementError(f"{name} must be a finite number, not {value!r}")
    return float(value)


def whole_number(name: str, value: object, *, least: int) -> int:
    """The value as an int.

    Raises
    ------
    MeasurementError
        If it is no whole number, or less than ``least``.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise MeasurementError(f"{name} must be a whole number of at least {least}, not {value!r}")
    return int(value)
