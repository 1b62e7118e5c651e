"""Facets of a depth map: found from the map alone, without being told how many there are or where."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from irpmd_rig.core.arguments import whole_number
from irpmd_rig.core.errors import EvaluationError, FramesError

# Depth is compared over this many pixels: more than the optics blur, less than a facet.
_REACH_PX = 4
_EDGE_SIGMAS = 10.0
_BRIDGED_PX = 3  # half the widest line of unknown pixels over which a surface is taken to go on
_NECK_PX = 2  # half the width of a bridge between facets that is cut
_OUTLIER_SIGMAS = 6.0
_DEBRIS = 0.02  # a patch below this fraction of the largest is no facet, unless the caller says otherwise
_FEWEST_PIXELS = 100


@dataclass(frozen=True, slots=True)
class Facets:
    """Connected smooth parts of a surface.

    Attributes
    ----------
    labels : ndarray of int32, (H, W)
        1..count inside the eroded facets, 0 elsewhere; numbered along the direction in which their centres spread,
        such that the last is higher than the first.
    count : int
        Number of facets.
    noise_mm : float
        Noise of a pixel of the depth map, estimated from the map.
    too_small : tuple of int
        Pixels of each smooth patch that is no facet because erosion leaves too few of them.
    """

    labels: NDArray[np.int32]
    count: int
    noise_mm: float
    too_small: tuple[int, ...] = ()

    def mask(self, facet: int) -> NDArray[np.bool_]:
        """Pixels of facet 1..count."""
        return np.asarray(self.labels == facet)


def find_facets(
    depth_mm: NDArray[np.floating],
    valid: NDArray[np.bool_] | None = None,
    *,
    erosion_px: int = 3,
    min_pixels: int | None = None,
) -> Facets:
    """Find the facets of a stepped, also curved, surface.

    Parameters
    ----------
    depth_mm : ndarray, (H, W)
        Height; NaN where unknown.
    valid : ndarray of bool, (H, W), optional
        Where the height may be used; everywhere finite by default.
    erosion_px : int
        Pixels taken off at every edge: the optics mix both sides there (physics notes, section 4: 50 to 258 um
        without, 0.2 um with 2 px).
    min_pixels : int, optional
        Smallest facet, after erosion. By default 2 % of the largest one and at least 100.

    Returns
    -------
    Facets
        See there.

    Raises
    ------
    FramesError
        If map and mask differ in shape.
    EvaluationError
        If there is no facet.

    Notes
    -----
    An edge is where the median-filtered height changes over four pixels by ten times what it typically does; steps
    below about eight times the noise of a pixel are not seen. Lines and specks of unknown pixels up to 6 px wide
    do not part a surface that goes on behind them.
    """
    depth_mm = np.asarray(depth_mm)
    valid = np.ones(depth_mm.shape, dtype=bool) if valid is None else np.asarray(valid)
    whole_number("erosion_px", erosion_px, least=0)
    if min_pixels is not None:
        whole_number("min_pixels", min_pixels, least=1)
    is_map = depth_mm.ndim == 2 and depth_mm.dtype.kind == "f"
    if not is_map or valid.shape != depth_mm.shape or valid.dtype.kind not in "biu":
        raise FramesError(
            f"the depth map must be (H, W) floating-point numbers with a mask alike, not {depth_mm.shape} "
            f"{depth_mm.dtype} and {valid.shape} {valid.dtype}"
        )
    known = np.isfinite(depth_mm) & valid.astype(bool)
    if known.sum() < _FEWEST_PIXELS:
        raise EvaluationError(f"only {int(known.sum())} pixels have a depth: no facet can be found")
    rows, columns = np.nonzero(known)
    window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    inside = _find(depth_mm[window], known[window], erosion_px, min_pixels)
    labels = np.zeros(depth_mm.shape, dtype=np.int32)
    labels[window] = inside.labels
    return Facets(labels, inside.count, inside.noise_mm, inside.too_small)


def _find(depth_mm: NDArray[np.floating], known: NDArray[np.bool_], erosion_px: int, min_pixels: int | None) -> Facets:
    noise = pixel_noise_mm(depth_mm, known)
    smooth, whole, change = _continuity(depth_mm, known)
    # The filter computes in single precision: smaller changes than its rounding mean nothing.
    rounding = 8 * float(np.spacing(np.abs(smooth[known]).max()))
    edge = _typical_limit(change[whole]) + rounding
    labels = _connected(whole & (change <= edge))
    labels[~known | (np.abs(depth_mm - smooth) > max(_OUTLIER_SIGMAS * noise, edge))] = 0
    inner = _eroded(labels, erosion_px) * (labels > 0)
    return _numbered(inner, np.bincount(labels.ravel()), depth_mm, noise, min_pixels)


def pixel_noise_mm(depth_mm: NDArray[np.floating], known: NDArray[np.bool_]) -> float:
    """Robust noise of a pixel from second differences over two pixels, to which slopes do not contribute."""
    values = np.where(known, depth_mm, np.nan)
    second = np.concatenate(
        [
            (values[:, :-4] - 2 * values[:, 2:-2] + values[:, 4:]).ravel(),
            (values[:-4] - 2 * values[2:-2] + values[4:]).ravel(),
        ]
    )
    second = second[np.isfinite(second)]
    if second.size == 0:
        raise EvaluationError("no two neighbouring pixels have a depth: no facet can be found")
    return float(1.4826 * np.median(np.abs(second)) / np.sqrt(6))


def _continuity(
    depth_mm: NDArray[np.floating], known: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.float32]]:
    """Median-filtered depth, the measured region with its specks closed, and the change of depth around a pixel."""
    # Unknown pixels take the nearest depth: a speck then changes nothing, an edge stays one.
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = depth_mm[tuple(nearest)].astype(np.float32)
    smooth = np.asarray(cv2.medianBlur(cv2.medianBlur(filled, 5), 5), dtype=np.float32)
    half = _REACH_PX // 2
    along = np.abs(np.roll(smooth, -half, 1) - np.roll(smooth, half, 1))
    down = np.abs(np.roll(smooth, -half, 0) - np.roll(smooth, half, 0))
    along[:, :half], along[:, -half:], down[:half], down[-half:] = 0, 0, 0, 0
    whole = known | ndimage.binary_closing(np.pad(known, 8), iterations=_BRIDGED_PX)[8:-8, 8:-8]
    return smooth, whole, np.maximum(along, down)


def _typical_limit(change: NDArray[np.float32]) -> float:
    middle = float(np.median(change))
    spread = 1.4826 * float(np.median(np.abs(change - middle)))
    return middle + _EDGE_SIGMAS * spread


def _connected(smooth_region: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Label connected regions; a neck narrower than a few pixels does not connect."""
    core = ndimage.binary_erosion(smooth_region, iterations=_NECK_PX)
    labels, _ = ndimage.label(core)
    nearest = ndimage.distance_transform_edt(labels == 0, return_distances=True, return_indices=True)
    distance, indices = nearest
    grown = labels[tuple(indices)]
    grown[(distance > 1.5 * _NECK_PX) | ~smooth_region] = 0
    return np.asarray(grown, dtype=np.int32)


def _eroded(labels: NDArray[np.int32], pixels: int) -> NDArray[np.int32]:
    """Take pixels off at the edges of facets, but not around single unknown pixels inside them."""
    # The grey-level closing fills specks with their surroundings' label; different labels never merge.
    filled = ndimage.grey_closing(labels, size=(3, 3))
    size = 2 * pixels + 1
    low = ndimage.minimum_filter(filled, size=size, mode="constant")
    high = ndimage.maximum_filter(filled, size=size, mode="constant")
    return np.asarray(np.where(low == high, low, 0), dtype=np.int32)


def _numbered(
    labels: NDArray[np.int32],
    before: NDArray[np.intp],
    depth_mm: NDArray[np.floating],
    noise_mm: float,
    min_pixels: int | None,
) -> Facets:
    sizes = np.bincount(labels.ravel(), minlength=len(before))
    sizes[0] = 0
    fewest = max(_FEWEST_PIXELS, int(_DEBRIS * sizes.max())) if min_pixels is None else min_pixels
    kept = np.nonzero(sizes >= max(fewest, 1))[0]
    if kept.size == 0:
        raise EvaluationError(
            f"no smooth patch of at least {fewest} pixels is left after erosion: the largest has {int(sizes.max())}"
        )
    centres = np.array(ndimage.center_of_mass(labels > 0, labels, kept))
    heights = ndimage.mean(np.nan_to_num(depth_mm), labels, kept)
    order = _along_principal_direction(centres, np.asarray(heights))
    renumbered = np.zeros(sizes.size, dtype=np.int32)
    renumbered[kept[order]] = np.arange(1, kept.size + 1)
    lost = np.setdiff1d(np.nonzero(before >= max(fewest, 1))[0], [0, *kept])
    return Facets(renumbered[labels], int(kept.size), noise_mm, tuple(int(size) for size in before[lost]))


def _along_principal_direction(centres: NDArray[np.float64], heights: NDArray[np.float64]) -> NDArray[np.intp]:
    spread = centres - centres.mean(axis=0)
    direction = np.linalg.svd(spread, full_matrices=False)[2][0]
    order = np.argsort(spread @ direction)
    return order if heights[order[0]] <= heights[order[-1]] else order[::-1]
