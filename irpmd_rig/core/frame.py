"""Frame M: the reference plane z = 0, seen from the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.planes import Plane


@dataclass(frozen=True, slots=True)
class ReferenceFrame:
    """The camera's place in frame M.

    Attributes
    ----------
    axes : ndarray, (3, 3)
        Rows are the x, y and z axes of M in the camera's frame.
    camera_mm : ndarray, (3,)
        The camera's centre in M; its z is the distance to the reference plane.
    """

    axes: NDArray[np.float64]
    camera_mm: NDArray[np.float64]

    def directions(self, rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Rays (..., 3) of the camera turned into M."""
        return np.asarray(rays @ self.axes.T)

    def points_mm(self, height_mm: NDArray[np.floating], rays: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of M from heights above the reference plane.

        Parameters
        ----------
        height_mm : ndarray, (H, W)
            Height h; NaN where unknown.
        rays : ndarray, (H, W, 3)
            Undistorted rays of the camera (`irpmd_rig.core.rays`).

        Returns
        -------
        ndarray, (H, W, 3)
            X, Y, Z in mm; NaN where the height is unknown.
        """
        directions = self.directions(rays)
        reach = (height_mm - self.camera_mm[2]) / directions[..., 2]
        points = self.camera_mm + reach[..., None] * directions
        points[..., 2] = height_mm
        return np.asarray(points)

    def plane(self, plane: Plane) -> tuple[NDArray[np.float64], float]:
        """Normal in M (toward the camera's side) and offset n . X of a plane given in the camera's frame."""
        normal = self.axes @ plane.normal
        return normal, float(normal @ self.camera_mm - plane.distance_mm)


def reference_frame(
    mirror: Plane,
    *,
    camera_xy_mm: tuple[float, float] = (0.0, 0.0),
    heading: tuple[float, float] = (1.0, 0.0),
) -> ReferenceFrame:
    """Frame M from the plane of the (sprayed) reference mirror in the camera's frame.

    Parameters
    ----------
    mirror : Plane
        Fitted in the camera's frame.
    camera_xy_mm : tuple of float
        Where the rig's drawing puts the camera over the reference plane. It only shifts X and Y; heights do not
        depend on it.
    heading : tuple of float
        Direction in M's x, y in which the camera looks, seen from above (by the drawing).

    Returns
    -------
    ReferenceFrame
        z along the mirror's normal toward the camera, x and y fixed by the camera's heading.

    Raises
    ------
    CalibrationError
        If the camera looks straight down on the mirror: x would be undetermined.
    """
    z = mirror.normal
    along = np.array([0.0, 0.0, 1.0])
    level = along - (along @ z) * z
    length = float(np.linalg.norm(level))
    if length < 1e-3:
        raise CalibrationError("the camera looks along the mirror's normal: its heading cannot serve as the x axis")
    level /= length
    cosine, sine = np.array(heading) / np.hypot(*heading)
    across = np.cross(z, level)
    x = cosine * level - sine * across
    axes = np.stack([x, np.cross(z, x), z])
    return ReferenceFrame(axes, np.array([*camera_xy_mm, mirror.distance_mm]))
