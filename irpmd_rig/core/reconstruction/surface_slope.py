"""Slope of a surface across the fringes, from its own noisy depth: x fringes alone do not show it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from irpmd_rig.core.reconstruction.local_fit import local_fit

Array = NDArray[np.float64]

# Depth is averaged over cells of this size and fitted over windows of 17 x 17 of them: a slope of about 1 mrad of
# noise in the paper's rig, which moves the depth by half a micrometre.
_CELL_MM = 0.8
_RADIUS_CELLS = 8


def slope_across(
    depth_mm: NDArray[Any], x_mm: NDArray[Any], y_mm: NDArray[Any], regions: NDArray[np.int32]
) -> NDArray[np.float32]:
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
    side = _cell_px(x_mm, y_mm)
    cells = _Cells(depth_mm.shape, side, np.where(np.isfinite(depth_mm), regions, 0))
    x, y, depth = (cells.means(values) for values in (x_mm, y_mm, depth_mm))
    fit = local_fit(x, y, depth, cells.regions, _RADIUS_CELLS)
    known = np.isfinite(fit.gy)
    if not known.any():
        return np.zeros(depth_mm.shape, np.float32)
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    middle_x, middle_y, slope, by_x, by_y = (
        cells.spread(values[tuple(nearest)]) for values in (x, y, fit.gy, fit.hxy, fit.hyy)
    )
    # A curved surface's slope changes within a cell; beyond the region it is not carried on.
    inside = cells.spread(known)
    dx, dy = (np.where(inside & np.isfinite(depth_mm), a - b, 0.0) for a, b in ((x_mm, middle_x), (y_mm, middle_y)))
    return np.asarray(slope + by_x * dx + by_y * dy, dtype=np.float32)


class _Cells:
    """Square cells of pixels that belong to one region each."""

    def __init__(self, shape: tuple[int, int], side: int, regions: NDArray[np.int32]) -> None:
        self._shape, self._side = shape, side
        padded = self._padded(regions)
        self.regions = padded.max(axis=(1, 3))
        # A cell across an edge belongs to nobody.
        least = np.where(padded > 0, padded, np.iinfo(np.int32).max).min(axis=(1, 3))
        self.regions[least != self.regions] = 0
        self._used = (padded > 0) & (self.regions > 0)[:, None, :, None]
        self._count = np.maximum(self._used.sum(axis=(1, 3)), 1)

    def means(self, values: NDArray[Any]) -> Array:
        """Mean over each cell's pixels, (rows, columns) of cells."""
        padded = self._padded(np.asarray(values, dtype=np.float64))
        means = np.where(self._used, padded, 0.0).sum(axis=(1, 3)) / self._count
        return np.asarray(np.where(self.regions > 0, means, np.nan))

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Every cell's value at all its pixels."""
        rows, columns = self._shape
        return values.repeat(self._side, axis=0).repeat(self._side, axis=1)[:rows, :columns]

    def _padded(self, values: NDArray[Any]) -> NDArray[Any]:
        side = self._side
        rows, columns = (-(-size // side) for size in self._shape)
        whole = np.zeros((rows * side, columns * side), values.dtype)
        whole[: self._shape[0], : self._shape[1]] = values
        return whole.reshape(rows, side, columns, side)


def _cell_px(x_mm: NDArray[Any], y_mm: NDArray[Any]) -> int:
    across = np.concatenate([np.abs(np.diff(y_mm, axis=0)).ravel(), np.abs(np.diff(x_mm, axis=1)).ravel()])
    across = across[np.isfinite(across)]
    pitch = float(np.median(across)) if across.size else _CELL_MM
    return max(1, round(_CELL_MM / max(pitch, 1e-3)))
