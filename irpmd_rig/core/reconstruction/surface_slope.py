"""Slope of a surface across the fringes, from its own noisy depth: x fringes alone do not show it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.reconstruction.local_fit import local_fit

Array = NDArray[np.float64]
Map = NDArray[np.floating[Any]]

# Depth is averaged over cells of this size and fitted over windows of 17 x 17 of them: a slope of about 1 mrad of
# noise in the paper's rig, which moves the depth by half a micrometre.
_CELL_MM = 0.8
_RADIUS_CELLS = 8
# Every third row of cells is fitted; the fit holds as far as to the nearest of these in the same region.
_FITTED_ROWS = slice(1, None, 3)
_NEAR_CELLS = 2.9
# Pixels along rows and columns from which the size of a cell is taken.
_SAMPLES = 32


def slope_across(depth_mm: Map, x_mm: Map, y_mm: Map, regions: NDArray[np.int32]) -> NDArray[np.float32]:
    """dz/dy of a surface that is smooth within regions.

    Parameters
    ----------
    depth_mm, x_mm, y_mm : ndarray, (h, w)
        Points of the surface; NaN where unknown.
    regions : ndarray of int32, (h, w)
        As `irpmd_rig.core.reconstruction.smooth_regions`.

    Returns
    -------
    ndarray of float32, (h, w)
        Slope; outside the regions that of the nearest place in one, and zero where there is none.
    """
    cells = Cells(np.where(np.isfinite(depth_mm), regions, 0).astype(np.int32), cell_px(x_mm, y_mm))
    fit = cells.fit(*(cells.means(values) for values in (x_mm, y_mm, depth_mm)))
    return cells.spread(fit, x_mm, y_mm, np.ones(cells.regions.shape), (0.0, 0.0))


class SlopeFit(NamedTuple):
    """dz/dy of every cell, as it is at (x, y), and its derivatives by x and y; (rows, columns) each."""

    x: Map
    y: Map
    slope: Array
    by_x: Array
    by_y: Array


class Cells:
    """Square cells of pixels that belong to one region each.

    Attributes
    ----------
    regions : ndarray of int32, (rows, columns)
        Region of each cell; 0: a cell across an edge, or outside, belongs to nobody.
    """

    def __init__(self, regions: NDArray[np.int32], side: int) -> None:
        self._pixels, self._side = np.ascontiguousarray(regions), side
        shape = [-(-size // side) for size in regions.shape]
        self.regions = np.zeros(shape, np.int32)
        self._count = np.zeros(shape)
        _assign(self._pixels, side, self.regions, self._count)

    def means(self, values: Map) -> Array:
        """Mean over each cell's pixels, (rows, columns) of cells; NaN where it belongs to nobody."""
        sums = np.zeros(self.regions.shape)
        _sum_up(values, self._pixels, self._side, self.regions, sums)
        with np.errstate(invalid="ignore"):
            return np.asarray(sums / self._count)

    def fit(self, x_mm: Map, y_mm: Map, depth_mm: Map) -> SlopeFit:
        """Slope from the points of all cells; outside all regions that of the nearest cell, zero if there is none."""
        fit = local_fit(x_mm, y_mm, depth_mm, self.regions, _RADIUS_CELLS, rows=_FITTED_ROWS)
        fitted = np.isfinite(fit.gy)
        if not fitted.any():
            return SlopeFit(*np.zeros((5, *fitted.shape)))
        away, v, u = _nearest(fitted)
        # Carried on from the cell that was fitted: a curved surface's slope changes.
        by_x, by_y = fit.hxy[v, u], fit.hyy[v, u]
        slope = fit.gy[v, u] + by_x * (x_mm - x_mm[v, u]) + by_y * (y_mm - y_mm[v, u])
        known = np.isfinite(slope) & (self.regions[v, u] == self.regions) & (away < _NEAR_CELLS)
        # Beyond the region it is not.
        _, v, u = _nearest(known)
        by_x, by_y = (np.where(known, values, 0.0) for values in (by_x, by_y))
        return SlopeFit(x_mm[v, u], y_mm[v, u], slope[v, u], by_x, by_y)

    def spread(
        self, fit: SlopeFit, rays_x: Map, rays_y: Map, reach: Array, camera: tuple[float, float]
    ) -> NDArray[np.float32]:
        """Slope at every pixel, (h, w).

        Parameters
        ----------
        fit : SlopeFit
            Of the cells.
        rays_x, rays_y : ndarray, (h, w)
            A pixel sees (camera + reach ray): its place, x and y.
        reach : ndarray, (rows, columns)
            Of each cell.
        camera : tuple of float
            x and y.
        """
        slope = np.empty(self._pixels.shape, np.float32)
        _spread(fit, rays_x, rays_y, np.nan_to_num(reach), camera, self._side, slope)
        return slope


def _nearest(known: NDArray[np.bool_]) -> tuple[Array, NDArray[np.int32], NDArray[np.int32]]:
    """Distance, row and column of the nearest cell that is known, of every cell."""
    away, (v, u) = distance_transform_edt(~known, return_indices=True)
    return away, v, u


def cell_px(x_mm: Map, y_mm: Map) -> int:
    """Side of a cell in pixels where neighbouring pixels see these places, (h, w)."""
    thin = tuple(slice(None, None, max(1, size // _SAMPLES)) for size in x_mm.shape)
    steps = (np.hypot(np.diff(x_mm, axis=axis)[thin], np.diff(y_mm, axis=axis)[thin]).ravel() for axis in (0, 1))
    across = np.concatenate(tuple(steps))
    across = across[np.isfinite(across)]
    pitch = float(np.median(across)) if across.size else _CELL_MM
    return max(1, round(_CELL_MM / max(pitch, 1e-3)))


@njit(cache=True, nogil=True, error_model="numpy")
def _assign(pixels: NDArray[np.int32], side: int, regions: NDArray[np.int32], count: Array) -> None:
    height, width = pixels.shape
    for row in range(height):
        for column in range(width):
            region = pixels[row, column]
            if region == 0:
                continue
            v, u = row // side, column // side
            if regions[v, u] == 0:
                regions[v, u] = region
            elif regions[v, u] != region:
                regions[v, u] = -1
            count[v, u] += 1.0
    for v in range(regions.shape[0]):
        for u in range(regions.shape[1]):
            if regions[v, u] < 0:
                regions[v, u] = 0
                count[v, u] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_up(values: Map, pixels: NDArray[np.int32], side: int, regions: NDArray[np.int32], sums: Array) -> None:
    for v in range(regions.shape[0]):
        for u in range(regions.shape[1]):
            if regions[v, u] == 0:
                continue
            total = 0.0
            for row in range(v * side, min((v + 1) * side, pixels.shape[0])):
                for column in range(u * side, min((u + 1) * side, pixels.shape[1])):
                    if pixels[row, column] != 0:
                        total += values[row, column]
            sums[v, u] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _spread(
    fit: SlopeFit, rays_x: Map, rays_y: Map, reach: Array, camera: Any, side: int, slope: NDArray[np.float32]
) -> None:
    for row in range(slope.shape[0]):
        v = row // side
        for u in range(reach.shape[1]):
            middle_x, middle_y = fit.x[v, u] - camera[0], fit.y[v, u] - camera[1]
            for column in range(u * side, min((u + 1) * side, slope.shape[1])):
                x = reach[v, u] * rays_x[row, column] - middle_x
                y = reach[v, u] * rays_y[row, column] - middle_y
                change = fit.by_x[v, u] * x + fit.by_y[v, u] * y
                # Where the place is unknown, the cell's own slope is the best there is.
                slope[row, column] = fit.slope[v, u] + (change if change - change == 0.0 else 0.0)


for _kernel in (_assign, _sum_up, _spread):
    announce_compilation(_kernel, "the cells of the slope")
