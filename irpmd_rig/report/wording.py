"""Numbers and times as a person reads them."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from math import floor, isfinite, log10

MISSING = "-"


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, without a power of ten where it is not needed."""
    if value is None or not isfinite(value):
        return MISSING
    if value == 0 or 1e-4 <= abs(value) < 1e7:
        return fixed(value, 0 if value == 0 else max(0, digits - 1 - floor(log10(abs(value)))))
    return f"{value:.{digits - 1}e}"


def fixed(value: float | None, decimals: int) -> str:
    """A number with so many decimals."""
    return MISSING if value is None or not isfinite(value) else f"{value:.{decimals}f}"


def signed(value: float | None, decimals: int) -> str:
    """A number with its sign."""
    return MISSING if value is None or not isfinite(value) else f"{value:+.{decimals}f}"


def decimals_of(sigma: float | None, otherwise: int) -> int:
    """Decimals that leave an uncertainty two digits."""
    if sigma is None or not isfinite(sigma) or sigma <= 0:
        return otherwise
    return min(9, max(0, 1 - floor(log10(sigma))))


def with_sigma(value: float | None, sigma: float | None, otherwise: int = 4) -> str:
    """A value with its uncertainty of one sigma, both to two digits of that."""
    decimals = decimals_of(sigma, otherwise)
    if sigma is None or not isfinite(sigma):
        return fixed(value, decimals)
    return f"{fixed(value, decimals)} ± {fixed(sigma, decimals)}"


def micrometres(value_um: float | None) -> str:
    """A length in um: two digits, a hundredth at the finest."""
    if value_um is None or not isfinite(value_um):
        return MISSING
    return fixed(value_um, 2 if abs(value_um) < 1 else 1 if abs(value_um) < 100 else 0)


def percent(fraction: float | None) -> str:
    """A share."""
    return MISSING if fraction is None else f"{100 * fraction:.1f} %"


def listed(values: Iterable[float], digits: int = 6) -> str:
    """Numbers one after the other."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


def moment(text: str | None) -> str:
    """A time as a person writes it; what is no time stays as it is."""
    if not text:
        return MISSING
    try:
        return f"{datetime.fromisoformat(text):%Y-%m-%d %H:%M:%S %Z}"
    except ValueError:
        return text


def days_between(earlier: str | None, later: str | None) -> float | None:
    """Days from one time to another; None if either is not known."""
    try:
        return (datetime.fromisoformat(later or "") - datetime.fromisoformat(earlier or "")).total_seconds() / 86400
    except (TypeError, ValueError):
        return None
