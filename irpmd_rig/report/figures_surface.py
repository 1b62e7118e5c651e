"""The shape in perspective, as a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irpmd_rig.report.drawing import styled

_POINTS = 110  # along the longer side: as many as a picture tells apart
_ELEVATION_DEG, _AZIMUTH_DEG = 32, -60
_DPI = 150
_FLATTEST = 0.15  # height of the box over its side


@styled
def surface(points_mm: NDArray[np.floating], labels: NDArray[np.integer] | None = None) -> Figure:
    """Points of a surface in perspective, coloured by their height; the heights are to scale, as far as they can be.

    Parameters
    ----------
    points_mm
        (H, W, 3); NaN where not known.
    labels
        Facets, (H, W): what belongs to none (0) is left out; all points by default.
    """
    figure = Figure(figsize=(6.6, 4.9), dpi=_DPI)
    axes: Any = figure.add_axes((0.0, 0.02, 0.84, 0.98), projection="3d")
    stride = max(1, max(points_mm.shape[:2]) // _POINTS)
    thin = points_mm[::stride, ::stride]
    shown = np.isfinite(thin).all(axis=-1)
    if labels is not None:
        shown &= labels[::stride, ::stride] > 0
    x, y, z = thin[shown].T
    cloud = axes.scatter(x, y, z, c=z, s=3, linewidths=0, cmap="viridis", depthshade=False)
    # One picture instead of thousands of marks: an SVG stays small.
    axes.set_rasterized(True)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    if z.size:
        side = max(float(np.ptp(x)), float(np.ptp(y)), 1e-6)
        axes.set_box_aspect((np.ptp(x) / side, np.ptp(y) / side, max(float(np.ptp(z)) / side, _FLATTEST)))
    axes.view_init(elev=_ELEVATION_DEG, azim=_AZIMUTH_DEG)
    figure.colorbar(cloud, cax=figure.add_axes((0.87, 0.2, 0.025, 0.6)), label="height (mm)")
    return figure
