"""The projector's lens: which of its pixels lights a point."""

import math

import numpy as np
from numpy.typing import NDArray

from sims.camera_rays import brown, monotone_reach
from sims.compiled import inner_kernel
from sims.frames import Matrix, Vector, attitude, turn
from sims.instruments import Projector

# Places in the kernel's array of lens numbers.
_FOCAL, _CX, _CY, WIDTH, HEIGHT, _WARP, _PERIOD, _REACH, _BROWN = 0, 1, 2, 3, 4, 5, 6, 7, 8
LENS_NUMBERS = 13


def lens_numbers(projector: Projector) -> NDArray[np.float64]:
    """Pack the lens for the kernel; focal length and warp in projector pixels."""
    width, height = projector.size_px
    return np.array(
        [
            projector.focal_mm / (projector.pixel_um * 1e-3),
            (width - 1) / 2,
            (height - 1) / 2,
            width,
            height,
            projector.warp_amplitude_px,
            projector.warp_period_px,
            monotone_reach(projector.distortion),
            *projector.distortion,
        ]
    )


def projector_frame(projector: Projector) -> tuple[Vector, Matrix]:
    """Position in mm and axes (rows: along columns, along rows, forward) in frame W, tilts included."""
    axes = attitude(projector.axis, projector.roll_deg)
    position = np.array(projector.position_mm)
    pivot = position + projector.tilt_pivot_mm * axes[2]
    tilt = turn(projector.tilt_about_x_deg, projector.tilt_about_y_deg)
    if projector.mirrored:
        axes[0] = -axes[0]
    return pivot + tilt @ (position - pivot), axes @ tilt.T


@inner_kernel
def projector_pixel(lens: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float]:
    """Exact (column, row) that lights the point (x, y, z) of the projector's frame; NaN outside its field."""
    if z <= 0.0:
        return np.nan, np.nan
    xn, yn = x / z, y / z
    if xn * xn + yn * yn >= lens[_REACH]:
        return np.nan, np.nan
    k = _BROWN
    xd, yd = brown(xn, yn, (lens[k], lens[k + 1], lens[k + 2], lens[k + 3], lens[k + 4]))
    column = lens[_CX] + lens[_FOCAL] * xd
    row = lens[_CY] + lens[_FOCAL] * yd
    if lens[_WARP] != 0.0:
        a, b = 2.0 * math.pi * column / lens[_PERIOD], 2.0 * math.pi * row / lens[_PERIOD]
        column, row = (
            column + lens[_WARP] * math.sin(a) * math.cos(b),
            row + lens[_WARP] * math.cos(a) * math.sin(b),
        )
    inside = -0.5 <= column < lens[WIDTH] - 0.5 and -0.5 <= row < lens[HEIGHT] - 0.5
    if not inside:
        return np.nan, np.nan
    return column, row
