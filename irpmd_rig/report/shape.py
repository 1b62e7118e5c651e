"""Shape of the measured object: points, facets, and what the fitted surfaces leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyParseError

from irpmd_rig.report.reading import Content, Run
from irpmd_rig.store.errors import FileNotInRun

_DEGREE = 5  # of the polynomial through a curved facet
_FITTED = 20_000  # of its points: more say no more
_LEAST = 100

Map = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """The part of the picture in which a depth is known.

    Attributes
    ----------
    window
        Its rows and columns.
    depth_mm, sigma_mm
        Height and its uncertainty, (H, W); NaN where not known. Sigma is None where the method does not tell it.
    points_mm, labels
        (H, W, 3) and (H, W): facets, 0 for none.
    residual_um
        Height beside the surface fitted to the facet, (H, W); NaN outside the facets.
    """

    window: tuple[slice, slice]
    depth_mm: Map
    sigma_mm: Map | None
    points_mm: Map
    labels: NDArray[np.int32]
    residual_um: Map


def read_shape(run: Run) -> Shape | None:
    """Read depth map and points; None if there are none. Raises RunFolderError if they are damaged."""
    results = run.folder.results
    try:
        depth = results.read_array("depth_mm.npy")
        cloud = results.path("points.ply")
    except FileNotInRun:
        return None
    known = np.isfinite(depth)
    rows, columns = (np.nonzero(known.any(axis=axis))[0] for axis in (1, 0))
    if rows.size == 0:
        return None
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    sigma = results.read_array("sigma_mm.npy")[window] if "sigma_mm.npy" in results.names() else None
    found = _points(cloud, known[window])
    if found is None:
        return None
    points, labels = found
    content = run.content or {}
    fitted = _fitted_map(run, content)
    if fitted is None:
        residual = residuals(points, labels, content.get("facets") or [])
    else:
        residual = np.where(labels > 0, 1e3 * (depth - fitted)[window], np.float32(np.nan)).astype(np.float32)
    return Shape(window, depth[window], sigma, points, labels, residual)


def _fitted_map(run: Run, content: Content) -> Map | None:
    """Heights of the facets' estimated surfaces at every pixel; None where the method is one of pixels alone."""
    found = (content.get("methods") or {}).get(content.get("method")) or {}
    name = found.get("depth_file")
    if name in (None, "depth_mm.npy") or name not in run.folder.results.names():
        return None
    fitted: Map = run.folder.results.read_array(name)
    return fitted


def _points(cloud: Path, known: NDArray[np.bool_]) -> tuple[Map, NDArray[np.int32]] | None:
    """Points and facets on the grid of the picture: the cloud has one a known pixel, in their order."""
    try:
        vertices = PlyData.read(str(cloud))["vertex"].data
    except (OSError, ValueError, KeyError, PlyParseError):
        return None
    if len(vertices) != np.count_nonzero(known):
        return None
    points = np.full((*known.shape, 3), np.nan, np.float32)
    points[known] = np.column_stack([vertices[axis] for axis in "xyz"])
    labels = np.zeros(known.shape, np.int32)
    if "facet" in (vertices.dtype.names or ()):
        labels[known] = vertices["facet"]
    return points, labels


def residuals(points_mm: Map, labels: NDArray[np.int32], facets: Sequence[Content]) -> Map:
    """Height beside the fitted surface of each facet, um, (H, W); NaN outside.

    Parameters
    ----------
    points_mm, labels
        (H, W, 3), (H, W).
    facets
        As in `result.json`: planes. Where one is curved, a polynomial of degree 5 in x and y is fitted here.
    """
    left = np.full(labels.shape, np.nan, np.float32)
    for facet in facets:
        inside = labels == facet["facet"]
        x, y, z = points_mm[inside].astype(np.float64).T
        if z.size == 0:
            continue
        if facet.get("flat", True):
            (cx, cy), (sx, sy) = facet["centre_mm"], facet["slope_rad"]
            fitted = facet["height_mm"] + sx * (x - cx) + sy * (y - cy)
        elif z.size >= _LEAST:
            fitted = _polynomial(x, y, z)
        else:
            continue
        left[inside] = 1e3 * (z - fitted)
    return left


def _polynomial(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    u, v = ((axis - axis.mean()) / (np.ptp(axis) / 2 or 1.0) for axis in (x, y))
    powers = [(i, k - i) for k in range(_DEGREE + 1) for i in range(k + 1)]
    design = np.stack([u**i * v**j for i, j in powers], axis=1)
    thin = slice(None, None, max(1, z.size // _FITTED))
    coefficients = np.linalg.lstsq(design[thin], z[thin], rcond=None)[0]
    return np.asarray(design @ coefficients)
