"""The depth equation's map, in bands of rows: small in memory, on every thread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from irpmd_rig.core import Intrinsics
from irpmd_rig.core.reconstruction.depth_equation import equation_depth
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.threads import over_rows
from irpmd_rig.processing.regions import Window

# The depth equation's dozen arrays of such a band stay in a core's own cache.
_BAND_PX = 40_000


def depth_map(views: Views, references: Views, *, d_mm: float, threads: int = 1) -> DepthMap:
    """Height above the reference plane by the depth equation.

    Parameters
    ----------
    views, references : Views
        Phases of the object and of the reference mirror at the same two positions, in one window.
    d_mm : float
        From the reference plane to the glass at the first position.
    threads : int
        Bands computed at the same time.

    Returns
    -------
    DepthMap
        As `irpmd_rig.core.reconstruction.depth_equation.equation_depth`.

    Raises
    ------
    FramesError, MeasurementError
        As there.
    """
    height, width = views.shape
    depth, sigma = (np.empty((height, width), np.float32) for _ in range(2))
    band = max(1, _BAND_PX // max(width, 1))

    def work(first: int, last: int) -> None:
        for top in range(first, last, band):
            rows = slice(top, min(top + band, last))
            part = equation_depth(_rows(views, rows), _rows(references, rows), d_mm=d_mm)
            depth[rows], sigma[rows] = part.depth_mm, part.sigma_mm

    over_rows(height, min(threads, max(height, 1)), work)
    return DepthMap(depth, sigma)


def _rows(views: Views, rows: slice) -> Views:
    above, columns = views.window
    return replace(
        views,
        phases_rad=tuple(phase[rows] for phase in views.phases_rad),
        sigmas_rad=tuple(sigma[rows] for sigma in views.sigmas_rad),
        window=(slice(above.start + rows.start, above.start + rows.stop), columns),
        phases_y_rad=None,
    )


def windowed(intrinsics: Intrinsics, window: Window) -> Intrinsics:
    """Give the camera that sees only a window of the picture: the same rays, fewer of them."""
    rows, columns = window
    (cx, cy) = intrinsics.principal_point_px
    return Intrinsics(
        size_px=(columns.stop - columns.start, rows.stop - rows.start),
        focal_px=intrinsics.focal_px,
        principal_point_px=(cx - columns.start, cy - rows.start),
        distortion=intrinsics.distortion,
    )
