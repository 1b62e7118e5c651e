"""How the ground glass leans against the reference mirror, and how it has to be turned to be parallel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.geometry import Drawing
from irpmd_rig.core.calibration.plate import PlatePlacement
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.frame import reference_frame
from irpmd_rig.core.planes import Plane, fit_plane

Floats = NDArray[np.float64]

_FEWEST_PX = 200
_VARIED_PX = 2000  # so many tell what a tilt of the plate does


@dataclass(frozen=True, slots=True)
class GlassTilt:
    """Turns that would bring a glass parallel to the mirror to where the glass is.

    Right-handed in frame M, whose z points from the mirror to the glass: where the turn about y is positive, the
    glass's +x side is nearer to the mirror; where the turn about x is positive, its +y side is farther from it.

    Attributes
    ----------
    about_x_rad, about_y_rad : float
        The turns.
    sigma_about_x_rad, sigma_about_y_rad : float
        One sigma of each: scatter of the two fitted planes, and tilt of the white plate.
    """

    about_x_rad: float
    about_y_rad: float
    sigma_about_x_rad: float
    sigma_about_y_rad: float

    def within(self, tolerance_rad: float) -> bool:
        """Whether neither turn is larger than a tolerance."""
        return max(abs(self.about_x_rad), abs(self.about_y_rad)) <= tolerance_rad


@dataclass(frozen=True, slots=True, eq=False)
class SeenPlanes:
    """One picture that shows the sprayed mirror and the glass directly.

    Attributes
    ----------
    position_mm : ndarray, (H, W)
        Plate position that each pixel's phase stands for (`irpmd_rig.core.PlateRelation.position_mm`), or NaN.
    rays : ndarray, (H, W, 3)
        Undistorted rays of the camera.
    mirror, glass : ndarray of bool, (H, W)
        Where each of them is seen.
    """

    position_mm: Floats
    rays: Floats
    mirror: NDArray[np.bool_]
    glass: NDArray[np.bool_]

    def planes(self, placement: PlatePlacement, stride: int = 1) -> tuple[Plane, Plane]:
        """Fit both planes in the camera's frame, from every `stride`-th row and column."""
        thin = np.s_[::stride, ::stride]
        depth = placement.depth_mm(self.position_mm[thin], self.rays[thin])
        mirror, glass = (fit_plane(self.rays[thin], depth, mask[thin]) for mask in (self.mirror, self.glass))
        return mirror, glass


def glass_tilt(seen: SeenPlanes, placement: PlatePlacement, plate_sigma_rad: float, drawing: Drawing) -> GlassTilt:
    """Compute the glass's tilt against the sprayed mirror.

    Parameters
    ----------
    seen : SeenPlanes
        What the picture shows.
    placement : PlatePlacement
        The white plate's absolute place.
    plate_sigma_rad : float
        One sigma of its tilt: by far the largest of what is systematic.
    drawing : Drawing
        Nominal places, which say where the axes of frame M are.

    Returns
    -------
    GlassTilt
        See there.

    Raises
    ------
    CalibrationError
        If mirror or glass is not seen, or its phases lie outside what the plate covered.
    """
    for name, mask in (("sprayed mirror", seen.mirror), ("glass", seen.glass)):
        known = int(np.count_nonzero(mask & np.isfinite(seen.position_mm)))
        if known < _FEWEST_PX:
            raise CalibrationError(
                f"of {int(mask.sum())} pixels of the {name} only {known} show a phase that the white plate covered: "
                f"check that it is seen and lit, or extend the plate's positions to the {name}"
            )
    planes = seen.planes(placement)
    frame = reference_frame(planes[0], camera_xy_mm=drawing.camera_xy_mm, heading=drawing.heading)
    turns = _turns(*planes, frame.axes)
    variance = np.zeros(2)
    for which, plane in enumerate(planes):
        step = 1e-6 * float(np.linalg.norm(plane.q))
        moved = [replace(plane, q=plane.q + step * axis) for axis in np.eye(3)]
        pairs = [(one, planes[1]) if which == 0 else (planes[0], one) for one in moved]
        gradient = np.stack([(_turns(*pair, frame.axes) - turns) / step for pair in pairs], axis=1)
        variance += np.diag(gradient @ plane.covariance @ gradient.T)
    thin = max(1, int(np.sqrt(known / _VARIED_PX)))
    base = _turns(*seen.planes(placement, thin), frame.axes)
    for axis in np.eye(3)[:2]:
        normal = placement.normal + plate_sigma_rad * np.cross(axis, placement.normal)
        tilted = replace(placement, normal=normal / np.linalg.norm(normal))
        variance += (_turns(*seen.planes(tilted, thin), frame.axes) - base) ** 2
    return GlassTilt(float(turns[0]), float(turns[1]), *(float(sigma) for sigma in np.sqrt(variance)))


def _turns(mirror: Plane, glass: Plane, axes: Floats) -> Floats:
    """Turns about x and y that bring the mirror's normal to the glass's, rad, (2,)."""
    turned = np.cross(axes @ mirror.normal, axes @ glass.normal)
    return np.asarray(turned[:2], dtype=np.float64)
