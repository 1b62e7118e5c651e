"""Quadratic surfaces fitted around every pixel, from the pixels of its own region alone."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.phase._wide_vectors import wide_vectors

Array = NDArray[np.float64]

_TERMS = 6
_FEWEST = 10
# A pivot below this fraction of its column's size: the pixels lie on a line or a conic.
_SINGULAR = 1e-6
# Pixels of a row that are fitted at once, and the sums of each: moments of the coordinates up to x^i y^j of degree 4,
# and of the values with those up to degree 2.
_BLOCK = 128
_SUMS = 21
_PITCH = _BLOCK + 24
_u = np.uintp
_AT = tuple(_u(_PITCH * k) for k in range(_SUMS))


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
    x: NDArray[Any],
    y: NDArray[Any],
    values: NDArray[Any],
    regions: NDArray[np.int32],
    radius: int,
    *,
    rows: slice = slice(None),
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
    rows : slice
        Rows that are fitted; NaN in the others.
    """
    results = np.full((_TERMS + 1, *values.shape), np.nan)
    used = np.where(np.isfinite(values), regions, 0).astype(np.int32)
    if used.any():
        # Coordinates of the order of one in every window: the normal equations are well conditioned there.
        pitch = max(
            float(np.nanmedian(np.abs(np.diff(a, axis=axis)))) if a.shape[axis] > 1 else 0.0
            for a, axis in ((x, 1), (y, 0))
        )
        # What is not used counts nothing; a NaN would all the same.
        coordinates = (np.where(used > 0, a, 0.0) for a in (x, y, values))
        fitted = np.arange(values.shape[0])[rows]
        _fit_all(*coordinates, used, fitted, radius, max(pitch, 1e-9) * radius, results)
    return LocalFit(*results)


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_all(
    x: Array,
    y: Array,
    values: Array,
    regions: NDArray[np.int32],
    rows: NDArray[np.int64],
    radius: int,
    scale: float,
    results: Array,
) -> None:
    height, width = values.shape
    matrix, right = np.empty((_TERMS, _TERMS)), np.empty((2, _TERMS))
    sums = np.empty(_SUMS * _PITCH)
    for row in rows:
        for first in range(0, width, _BLOCK):
            count = min(_BLOCK, width - first)
            sums[:] = 0.0
            for v in range(max(row - radius, 0), min(row + radius + 1, height)):
                for aside in range(-radius, radius + 1):
                    begin = max(first, -aside)
                    end = min(first + count, width - aside)
                    if begin < end:
                        _add(
                            (x[row], y[row], values[row], regions[row]), (x[v], y[v], values[v], regions[v]),
                            1.0 / scale, sums, begin, begin + aside, begin - first, end - begin,
                        )  # fmt: skip
            for i in range(count):
                column = first + i
                if regions[row, column] == 0 or sums[i] < _FEWEST:
                    continue
                _fill(sums, i, matrix, right)
                if _solve(matrix, right):
                    results[0, row, column] = values[row, column] + right[0, 0]
                    results[1, row, column] = right[0, 1] / scale
                    results[2, row, column] = right[0, 2] / scale
                    for k in range(3, _TERMS):
                        results[k, row, column] = right[0, k] / (scale * scale)
                    results[_TERMS, row, column] = right[1, 0]


@njit(nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def _add(middle: Any, beside: Any, per_mm: float, sums: Array, at: int, other: int, place: int, count: int) -> None:
    """Add to the sums of so many pixels of a row, from ``at`` on, what those from ``other`` on contribute to each."""
    wide_vectors()
    x0, y0, f0, region0 = middle
    x1, y1, f1, region1 = beside
    a, b, o = _u(at), _u(other), _u(place)
    for i in range(_u(count)):
        w = 1.0 if region1[b + i] == region0[a + i] else 0.0
        x, y, f = (x1[b + i] - x0[a + i]) * per_mm, (y1[b + i] - y0[a + i]) * per_mm, f1[b + i] - f0[a + i]
        j = o + i
        wx, wy, xx, xy, yy, wf = w * x, w * y, x * x, x * y, y * y, w * f
        sums[j] += w
        sums[_AT[1] + j] += wx
        sums[_AT[2] + j] += wy
        sums[_AT[3] + j] += wx * x
        sums[_AT[4] + j] += wx * y
        sums[_AT[5] + j] += wy * y
        sums[_AT[6] + j] += wx * xx
        sums[_AT[7] + j] += wx * xy
        sums[_AT[8] + j] += wx * yy
        sums[_AT[9] + j] += wy * yy
        sums[_AT[10] + j] += w * xx * xx
        sums[_AT[11] + j] += w * xx * xy
        sums[_AT[12] + j] += w * xx * yy
        sums[_AT[13] + j] += w * xy * yy
        sums[_AT[14] + j] += w * yy * yy
        sums[_AT[15] + j] += wf
        sums[_AT[16] + j] += wf * x
        sums[_AT[17] + j] += wf * y
        sums[_AT[18] + j] += wf * xx
        sums[_AT[19] + j] += wf * xy
        sums[_AT[20] + j] += wf * yy


@njit(nogil=True, error_model="numpy")
def _fill(sums: Array, i: int, matrix: Array, right: Array) -> None:
    """Normal equations of one pixel, lower triangle; the basis is 1, x, y, x^2 / 2, x y, y^2 / 2."""
    s = sums[i::_PITCH]
    matrix[0, 0] = s[0]
    matrix[1, 0], matrix[1, 1] = s[1], s[3]
    matrix[2, 0], matrix[2, 1], matrix[2, 2] = s[2], s[4], s[5]
    matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3] = s[3] / 2, s[6] / 2, s[7] / 2, s[10] / 4
    matrix[4, 0], matrix[4, 1], matrix[4, 2], matrix[4, 3], matrix[4, 4] = s[4], s[7], s[8], s[11] / 2, s[12]
    matrix[5, 0], matrix[5, 1], matrix[5, 2] = s[5] / 2, s[8] / 2, s[9] / 2
    matrix[5, 3], matrix[5, 4], matrix[5, 5] = s[12] / 4, s[13] / 2, s[14] / 4
    right[0, 0], right[0, 1], right[0, 2] = s[15], s[16], s[17]
    right[0, 3], right[0, 4], right[0, 5] = s[18] / 2, s[19], s[20] / 2
    right[1, :] = 0.0
    right[1, 0] = 1.0


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
