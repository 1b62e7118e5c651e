"""The depth map of a measurement, in bands of rows: small in memory, on every thread."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Intrinsics, direct_depth
from irpmd_rig.core.threads import over_rows
from irpmd_rig.processing.regions import Window

# The depth equation's dozen arrays of such a band stay in a core's own cache.
_BAND_PX = 40_000

Phase = NDArray[np.float32]


def depth_map(
    references: Sequence[NDArray[np.floating]],
    phases: Sequence[Phase],
    *,
    d_mm: float,
    delta_d_mm: float,
    window: Window,
    threads: int = 1,
) -> Phase:
    """Height above the reference plane by the depth equation.

    Parameters
    ----------
    references : sequence of two ndarray, (h, w)
        Absolute phases of the reference mirror at positions 1 and 2, in ``window``.
    phases : sequence of two ndarray of float32, (H, W)
        Absolute phases of the object at the same positions, of the whole picture.
    d_mm : float
        From the reference plane to the glass at position 1.
    delta_d_mm : float
        Travel from position 1 to position 2, positive away from the glass.
    window : tuple of slice
        Where the references are known; NaN outside.
    threads : int
        Bands computed at the same time.

    Returns
    -------
    ndarray of float32, (H, W)
        Height in mm, positive toward the glass; NaN where unknown.

    Raises
    ------
    FramesError, MeasurementError
        As `irpmd_rig.core.direct_depth`.
    """
    depth = np.full(phases[0].shape, np.nan, dtype=np.float32)
    maps = [*references, *(phase[window] for phase in phases)]
    inside = depth[window]
    height, width = inside.shape
    band = max(1, _BAND_PX // width)

    def work(first: int, last: int) -> None:
        for top in range(first, last, band):
            rows = slice(top, min(top + band, last))
            inside[rows] = direct_depth(*(phase[rows] for phase in maps), d_mm=d_mm, delta_d_mm=delta_d_mm)

    over_rows(height, min(threads, height), work)
    return depth


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
