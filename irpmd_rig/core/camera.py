"""The camera: intrinsics with their uncertainties, and the rays of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError

# The fixed-point inversion of the distortion gains a digit or two an iteration; lenses of this class converge to
# double precision in about ten.
_UNDISTORTION = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-13)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole and Brown distortion of a camera, in OpenCV's convention.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the sensor, px.
    focal_px : tuple of float
        fx, fy, px.
    principal_point_px : tuple of float
        cx, cy, px; the centre of the first pixel is (0, 0).
    distortion : tuple of float
        k1, k2, p1, p2, k3 (the order of Bouguet's toolbox and of OpenCV), for normalised coordinates.
    """

    size_px: tuple[int, int]
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        values = (*self.size_px, *self.focal_px, *self.principal_point_px, *self.distortion)
        if not np.all(np.isfinite(values)) or min(*self.size_px, *self.focal_px) <= 0:
            raise CalibrationError(
                f"intrinsics need finite numbers, a positive size and positive focal lengths, not {values}"
            )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix, (3, 3), px."""
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rays(intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Undistorted viewing directions of all pixels.

    Parameters
    ----------
    intrinsics : Intrinsics
        The camera.

    Returns
    -------
    ndarray of float64, (H, W, 3)
        Direction (x/z, y/z, 1) of each pixel's centre in the camera frame; not normalised, so that a point is Z
        times its ray.
    """
    width, height = intrinsics.size_px
    columns, rows = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    return rays_at(intrinsics, np.stack([columns, rows], axis=-1))


def rays_at(intrinsics: Intrinsics, pixels: NDArray[np.floating | np.integer]) -> NDArray[np.float64]:
    """Undistorted viewing directions of some places in the picture.

    Parameters
    ----------
    intrinsics : Intrinsics
        The camera.
    pixels : ndarray, (..., 2)
        Column and row, px.

    Returns
    -------
    ndarray of float64, (..., 3)
        As `rays`.
    """
    places = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    normalised = cv2.undistortPoints(places, intrinsics.matrix, np.array(intrinsics.distortion), criteria=_UNDISTORTION)
    directions = np.ones((*np.shape(pixels)[:-1], 3))
    directions[..., :2] = normalised.reshape(*np.shape(pixels)[:-1], 2)
    return directions
