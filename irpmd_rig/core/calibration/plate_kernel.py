"""Per-pixel polynomials, compiled: one small least-squares problem a pixel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

# A third of a pixel's phases without a position is a stretch over which the polynomial would be a guess.
_GAP_CELLS = 3


@njit(cache=True, nogil=True, error_model="numpy")
def fit_polynomials(
    phases: NDArray[np.float32],
    positions: NDArray[np.float64],
    fewest: int,
    largest_scatter: float,
    coefficients: NDArray[np.float64],
    centre: NDArray[np.float64],
    half_range: NDArray[np.float64],
) -> None:
    """Fit positions over phases (positions, H, W); results go into the last three arrays, NaN where impossible."""
    count, height, width = phases.shape
    terms = coefficients.shape[2]
    normal = np.empty((terms, terms))
    right = np.empty(terms)
    powers = np.empty(terms)
    for v in range(height):
        for u in range(width):
            low, high, seen = np.inf, -np.inf, 0
            for k in range(count):
                phase = np.float64(phases[k, v, u])
                if np.isfinite(phase):
                    low, high, seen = min(low, phase), max(high, phase), seen + 1
            centre[v, u] = 0.5 * (low + high)
            half_range[v, u] = 0.5 * (high - low)
            if seen < fewest or not half_range[v, u] > 0:
                coefficients[v, u, :] = np.nan
                centre[v, u] = np.nan
                half_range[v, u] = np.nan
                continue
            normal[:] = 0.0
            right[:] = 0.0
            for k in range(count):
                phase = np.float64(phases[k, v, u])
                if not np.isfinite(phase):
                    continue
                t = (phase - centre[v, u]) / half_range[v, u]
                powers[0] = 1.0
                for i in range(1, terms):
                    powers[i] = powers[i - 1] * t
                for i in range(terms):
                    right[i] += powers[i] * positions[k]
                    for j in range(i + 1):
                        normal[i, j] += powers[i] * powers[j]
            known = _solve_in_place(normal, right)
            if known:
                known = _describes(phases[:, v, u], positions, right, centre[v, u], half_range[v, u], largest_scatter)
            if not known:
                right[:] = np.nan
            coefficients[v, u, :] = right


@njit(cache=True, nogil=True, error_model="numpy")
def _solve_in_place(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> bool:
    """Cholesky solution of a small symmetric system (lower triangle given); False where it is singular."""
    n = vector.size
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not value > 1e-12 * matrix[0, 0]:
                    return False
                matrix[i, i] = np.sqrt(value)
            else:
                matrix[i, j] = value / matrix[j, j]
    for i in range(n):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _describes(
    phases: NDArray[np.float32],
    positions: NDArray[np.float64],
    polynomial: NDArray[np.float64],
    centre: float,
    half_range: float,
    largest_scatter: float,
) -> bool:
    """Whether one pixel's polynomial fits its positions, and no stretch of its phases is without a position."""
    total, seen = 0.0, 0
    cells = np.zeros(_GAP_CELLS, dtype=np.bool_)
    for k in range(positions.size):
        if not np.isfinite(phases[k]):
            continue
        t = (np.float64(phases[k]) - centre) / half_range
        value = polynomial[-1]
        for i in range(polynomial.size - 2, -1, -1):
            value = value * t + polynomial[i]
        total += (value - positions[k]) ** 2
        seen += 1
        cells[min(int(0.5 * (t + 1.0) * _GAP_CELLS), _GAP_CELLS - 1)] = True
    return bool(cells.all()) and total <= largest_scatter**2 * max(seen - polynomial.size, 1)


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate_polynomials(
    phase: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    centre: NDArray[np.float64],
    half_range: NDArray[np.float64],
    reach: float,
    position: NDArray[np.float64],
) -> None:
    """Evaluate at ``phase`` (H, W) into ``position``; NaN where the normalised phase is beyond ``reach``."""
    height, width = phase.shape
    terms = coefficients.shape[2]
    for v in range(height):
        for u in range(width):
            t = (phase[v, u] - centre[v, u]) / half_range[v, u]
            value = np.nan
            if abs(t) <= reach:
                value = coefficients[v, u, terms - 1]
                for i in range(terms - 2, -1, -1):
                    value = value * t + coefficients[v, u, i]
            position[v, u] = value
