"""What the methods of reconstruction take and give: an object's phases at several stage positions, and its depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import FramesError, MeasurementError

Map = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True)
class Views:
    """An object's phases at several stage positions, in one window of the camera's picture.

    Attributes
    ----------
    positions_mm : tuple of float
        Position of stage1 of each view, two or more different ones; refined from the glass where that was possible.
    phases_rad : tuple of ndarray, (h, w)
        Absolute phase along x of each view; NaN where unknown.
    sigmas_rad : tuple of ndarray, (h, w)
        Standard deviation of each view's phase, a pixel.
    window : tuple of slice
        Rows and columns of the camera's picture that the maps cover, both with start and stop.
    phases_y_rad : tuple of ndarray, (h, w), or None
        Absolute phase along y of each view, of the same count and noise; None where x fringes alone were shown.

    Raises
    ------
    FramesError
        If the maps are not of one shape, the window's, and as many as the positions.
    MeasurementError
        If there are no two different positions, or one is no finite number.
    """

    positions_mm: tuple[float, ...]
    phases_rad: tuple[Map, ...]
    sigmas_rad: tuple[Map, ...]
    window: tuple[slice, slice]
    phases_y_rad: tuple[Map, ...] | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.positions_mm).all() or len(set(self.positions_mm)) < 2:
            raise MeasurementError(
                f"a depth needs phases at two or more different stage positions, not {list(self.positions_mm)} mm"
            )
        groups = [self.phases_rad, self.sigmas_rad, *([] if self.phases_y_rad is None else [self.phases_y_rad])]
        if {len(maps) for maps in groups} != {len(self.positions_mm)}:
            raise FramesError(
                f"{len(self.positions_mm)} stage positions need as many phase and sigma maps, not "
                f"{[len(maps) for maps in groups]}"
            )
        shapes = {maps.shape for group in groups for maps in group}
        if shapes != {self.shape}:
            raise FramesError(f"the maps must have the window's shape {self.shape}, not {sorted(shapes)}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the window."""
        rows, columns = self.window
        return rows.stop - rows.start, columns.stop - columns.start


@dataclass(frozen=True, slots=True)
class DepthMap:
    """Depth a pixel.

    Attributes
    ----------
    depth_mm : ndarray of float32, (h, w)
        Height over the reference plane, toward the glass: z of frame M; NaN where unknown.
    sigma_mm : ndarray of float32, (h, w)
        Standard deviation of `depth_mm` by the noise of the phases: what a repetition of the frames would scatter.
        NaN where the depth is.
    slope_x, slope_y : ndarray of float32, (h, w), or None
        dz/dx and dz/dy of the surface in M, where the method finds them.
    """

    depth_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    slope_x: NDArray[np.float32] | None = None
    slope_y: NDArray[np.float32] | None = None
