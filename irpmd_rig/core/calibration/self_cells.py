"""Phase maps condensed to cells: what a self-calibration fits instead of millions of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from irpmd_rig.core.block_sums import block_sums
from irpmd_rig.core.calibration.rig_calibration import REGIONS, RigView

Array = NDArray[np.float64]

# About this many cells along the picture's longer side: small enough to show ripples of a projector's grey levels,
# large enough that the model is evaluated ten thousand times instead of millions.
_CELLS_ACROSS = 100
_SMALLEST_CELL_PX = 4
_LEAST_FILLED = 0.4
# The smooth surface that takes the phase's bend out of a cell and shows outliers; it need not be exact.
_DEGREE = 8
_TERMS = (_DEGREE + 1) * (_DEGREE + 2) // 2
_FIT_PIXELS = 8_000
_FEWEST_PIXELS = 10 * _TERMS
_OUTLIER_SIGMAS = 5.0
_ROUNDS = 2
_ROWS = ("view", "region", "axis", "row", "column", "pixel", "phase_rad", "sigma_rad")


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Mean phases of small squares of the picture, one row each.

    Attributes
    ----------
    view, region, axis : ndarray of int, (n,)
        Index of the view, of `REGIONS`, and 0 for the phase along x, 1 along y.
    row, column : ndarray of int, (n,)
        Of the cell in the picture's grid.
    pixel : ndarray, (n, 2)
        Column and row at which the phase holds, px.
    phase_rad, sigma_rad : ndarray, (n,)
        Mean phase there and its white noise.
    side_px : int
        Of a cell.
    """

    view: NDArray[np.intp]
    region: NDArray[np.intp]
    axis: NDArray[np.intp]
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    pixel: Array
    phase_rad: Array
    sigma_rad: Array
    side_px: int

    def __len__(self) -> int:
        return len(self.phase_rad)

    def of(self, chosen: NDArray[np.bool_]) -> Cells:
        """Some of the cells."""
        rows: dict[str, Any] = {name: getattr(self, name)[chosen] for name in _ROWS}
        return replace(self, **rows)


def condense(views: Sequence[RigView]) -> Cells:
    """Cells of all regions of all views, outlying pixels left out; raises nothing: there may be none."""
    side = max(_SMALLEST_CELL_PX, max(views[0].phase_rad.shape) // _CELLS_ACROSS)
    parts = []
    for number, view in enumerate(views):
        for axis, phase in enumerate((view.phase_rad, view.phase_y_rad)):
            for region, name in enumerate(REGIONS):
                if phase is None:
                    continue
                cells = _region_cells(phase, view.sigma_rad, view.region(name), side)
                if cells is not None:
                    labels = (np.full(len(cells[0]), label, dtype=np.intp) for label in (number, region, axis))
                    parts.append((*labels, *cells))
    if not parts:
        none = np.zeros(0, dtype=np.intp)
        return Cells(none, none, none, none, none, np.zeros((0, 2)), np.zeros(0), np.zeros(0), side)
    rows: dict[str, Any] = dict(zip(_ROWS, (np.concatenate(one) for one in zip(*parts, strict=True)), strict=True))
    return Cells(**rows, side_px=side)


def _region_cells(
    phase_rad: NDArray[np.floating], sigma_rad: float | NDArray[np.floating], mask: NDArray[np.bool_], side: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], Array, Array, Array] | None:
    """Rows, columns, pixels, phases and sigmas of the cells of one region; None if it is too small."""
    if np.count_nonzero(mask) < _FEWEST_PIXELS:
        return None
    window = _cell_window(mask, side)
    mask, phase = mask[window], phase_rad[window]
    if mask.size == 0:
        return None
    # Where a region is narrower than a cell too little of it is seen to tell its bend.
    cell = np.ones((side | 1, side | 1), np.uint8)
    wide = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, cell, borderValue=0)
    known = mask & (wide > 0) & np.isfinite(phase)
    if np.count_nonzero(known) < _FEWEST_PIXELS:
        return None
    height, width = known.shape
    axes = np.linspace(-1, 1, height), np.linspace(-1, 1, width)
    # Across a narrow region a high degree would go wild between the pixels: what counts is how wide it is on average.
    degrees = tuple(min(_DEGREE, 1 + np.count_nonzero(known) // across // side) for across in (width, height))
    coefficients, limit = _smooth(phase, known, axes, degrees)
    basis_v, basis_u = (chebyshev.chebvander(axis, _DEGREE) for axis in axes)
    with np.errstate(invalid="ignore"):
        residual = phase - basis_v @ coefficients @ basis_u.T
        use = known & (np.abs(residual) <= limit)
    count = block_sums(use.astype(np.float64), side)
    rows, columns = np.nonzero(count >= _LEAST_FILLED * side**2)
    if rows.size == 0:
        return None

    def mean(values: Array) -> Array:
        return np.asarray((block_sums(np.where(use, values, 0.0), side) / np.maximum(count, 1))[rows, columns])

    v, u = mean(axes[0][:, None]), mean(axes[1][None, :])
    # The mean of the residual belongs to the mean pixel: what is bent of it over a cell is far below its noise.
    value = chebyshev.chebval2d(v, u, coefficients) + mean(residual)
    variance = np.square(sigma_rad if np.ndim(sigma_rad) == 0 else np.asarray(sigma_rad)[window], dtype=np.float64)
    sigma = np.sqrt(mean(variance) / count[rows, columns])
    top, left = window[0].start, window[1].start
    pixel = np.stack([left + (u + 1) / 2 * (width - 1), top + (v + 1) / 2 * (height - 1)], axis=-1)
    return rows + top // side, columns + left // side, pixel, value, sigma


def _cell_window(region: NDArray[np.bool_], side: int) -> tuple[slice, slice]:
    """Bounding box of a region, on the picture's grid of cells."""
    slices = []
    for axis in (1, 0):
        places = np.nonzero(region.any(axis=axis))[0]
        first = int(places[0]) // side * side
        limit = region.shape[1 - axis] // side * side
        slices.append(slice(first, min(limit, (int(places[-1]) // side + 1) * side)))
    return slices[0], slices[1]


def _smooth(
    phase_rad: NDArray[np.floating], known: NDArray[np.bool_], axes: tuple[Array, Array], degrees: tuple[int, ...]
) -> tuple[Array, float]:
    """Chebyshev surface of total degree 8 or less through the known pixels, and the residual that makes an outlier."""
    step = max(1, int(np.sqrt(np.count_nonzero(known) / _FIT_PIXELS)))
    rows, columns = np.nonzero(known[::step, ::step])
    values = phase_rad[::step, ::step][rows, columns].astype(np.float64)
    basis_v, basis_u = (chebyshev.chebvander(axis[::step], _DEGREE) for axis in axes)
    pairs = [(i, j) for i in range(degrees[0] + 1) for j in range(min(degrees[1], _DEGREE - i) + 1)]
    design = np.stack([basis_v[rows, i] * basis_u[columns, j] for i, j in pairs], axis=1)
    keep = np.ones(len(values), dtype=np.bool_)
    for _ in range(_ROUNDS):
        part = design[keep]
        solution, *_ = np.linalg.lstsq(part.T @ part, part.T @ values[keep], rcond=1e-13)
        residual = np.abs(values - design @ solution)
        # A surface without noise has no spread: what is left is rounding.
        limit = _OUTLIER_SIGMAS * max(1.4826 * float(np.median(residual[keep])), 1e-6)
        keep = residual <= limit
    coefficients = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for (i, j), value in zip(pairs, solution, strict=True):
        coefficients[i, j] = value
    return coefficients, limit
