"""Quadratic surfaces fitted around every pixel, from the pixels of its own region alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irpmd_rig.core._kernel_notice import announce_compilation

Array = NDArray[np.float64]

_TERMS = 6
_FEWEST = 10
# A pivot below this fraction of its column's size: the pixels lie on a line or a conic.
_SINGULAR = 1e-6


class LocalFit(NamedTuple):
    """f = value + gx dx + gy dy + (hxx dx^2 + 2 hxy dx dy + hyy dy^2) / 2 about every pixel, (h, w) each.

    NaN where the region has too few pixels around. `gain` is the variance of `value` for independent values of
    unit variance.
    """

    value: Array
    gx: Array
    gy: Array
    hxx: Array
    hxy: Array
    hyy: Array
    gain: Array


def local_fit(
    x: NDArray[Any], y: NDArray[Any], values: NDArray[Any], regions: NDArray[np.int32], radius: int
) -> LocalFit:
    """Fit quadratic surfaces by least squares in square windows.

    Parameters
    ----------
    x, y : ndarray, (h, w)
        Coordinates of the pixels, in which the derivatives are taken.
    values : ndarray, (h, w)
        What is fitted; NaN where unknown.
    regions : ndarray of int32, (h, w)
        Only pixels of the same region as the middle one are used; 0: none is fitted.
    radius : int
        Half the side of the window, px: it has 2 radius + 1 pixels.
    """
    results = np.full((_TERMS + 1, *values.shape), np.nan)
    used = np.where(np.isfinite(values), regions, 0).astype(np.int32)
    if used.any():
        # Coordinates of the order of one in every window: the normal equations are well conditioned there.
        pitch = max(
            float(np.nanmedian(np.abs(np.diff(a, axis=axis)))) if a.shape[axis] > 1 else 0.0
            for a, axis in ((x, 1), (y, 0))
        )
        coordinates = (np.ascontiguousarray(a, dtype=np.float64) for a in (x, y, values))
        _fit_all(*coordinates, used, radius, max(pitch, 1e-9) * radius, results)
    return LocalFit(*results)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_all(
    x: Array, y: Array, values: Array, regions: NDArray[np.int32], radius: int, scale: float, results: Array
) -> None:
    height, width = values.shape
    matrix, right, basis = np.empty((_TERMS, _TERMS)), np.empty((2, _TERMS)), np.empty(_TERMS)
    for row in range(height):
        for column in range(width):
            region = regions[row, column]
            if region == 0:
                continue
            top, bottom = max(row - radius, 0), min(row + radius + 1, height)
            left, right_end = max(column - radius, 0), min(column + radius + 1, width)
            matrix[:] = 0.0
            right[:] = 0.0
            middle = values[row, column]
            count = 0
            for v in range(top, bottom):
                for u in range(left, right_end):
                    if regions[v, u] != region:
                        continue
                    count += 1
                    dx, dy = (x[v, u] - x[row, column]) / scale, (y[v, u] - y[row, column]) / scale
                    basis[0], basis[1], basis[2] = 1.0, dx, dy
                    basis[3], basis[4], basis[5] = dx * dx / 2, dx * dy, dy * dy / 2
                    for i in range(_TERMS):
                        right[0, i] += basis[i] * (values[v, u] - middle)
                        for j in range(i + 1):
                            matrix[i, j] += basis[i] * basis[j]
            if count < _FEWEST:
                continue
            right[1, 0] = 1.0
            if _solve(matrix, right):
                results[0, row, column] = middle + right[0, 0]
                results[1, row, column] = right[0, 1] / scale
                results[2, row, column] = right[0, 2] / scale
                for k in range(3, _TERMS):
                    results[k, row, column] = right[0, k] / (scale * scale)
                results[_TERMS, row, column] = right[1, 0]


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(matrix: Array, right: Array) -> bool:
    """Solve in place for both right sides by Cholesky's factorisation of the lower triangle."""
    for i in range(_TERMS):
        size = matrix[i, i]
        for k in range(i):
            matrix[i, i] -= matrix[i, k] * matrix[i, k]
        if not matrix[i, i] > _SINGULAR * size:
            return False
        matrix[i, i] = np.sqrt(matrix[i, i])
        for j in range(i + 1, _TERMS):
            for k in range(i):
                matrix[j, i] -= matrix[j, k] * matrix[i, k]
            matrix[j, i] /= matrix[i, i]
    for side in range(2):
        for i in range(_TERMS):
            for k in range(i):
                right[side, i] -= matrix[i, k] * right[side, k]
            right[side, i] /= matrix[i, i]
        for i in range(_TERMS - 1, -1, -1):
            for k in range(i + 1, _TERMS):
                right[side, i] -= matrix[k, i] * right[side, k]
            right[side, i] /= matrix[i, i]
    return True


announce_compilation(_fit_all, "the local fits")
