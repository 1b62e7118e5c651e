"""The estimated surface of a facet: its height anywhere, and how surely that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.frame import ReferenceFrame
from irpmd_rig.core.reconstruction.freeform import Array, Basis, Spline
from irpmd_rig.core.rig_model import RigModel

_MOST_ROUNDS = 30
_CLOSE_MM = 1e-10


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface over the camera's rays (`irpmd_rig.core.reconstruction.freeform`), placed in frame M.

    Attributes
    ----------
    model : RigModel
        The rig, of which the camera's place and rays matter here.
    basis : Basis
        Its functions.
    coefficients : ndarray, (count,)
        Theirs.
    covariance : ndarray, (count, count)
        By the noise of the phases.
    scattered : ndarray, (s, count)
        Changes by one standard deviation of each stage position: as random as the noise.
    displaced : tuple of (RigModel, ndarray (count,))
        The same surface under each displaced calibration: the rig and the coefficients' change.
    """

    model: RigModel
    basis: Basis
    coefficients: Array
    covariance: Array
    scattered: Array
    displaced: tuple[tuple[RigModel, Array], ...]

    def height_mm(self, xy_mm: Array) -> float:
        """Height z over a point (2,) of the reference plane.

        Raises
        ------
        EvaluationError
            If the surface would have to be continued too far to get there.
        """
        return self._at(xy_mm, self.model.frame, self.coefficients)[0]

    def slope(self, xy_mm: Array) -> Array:
        """dz/dx and dz/dy over a point (2,)."""
        tangent = self._at(xy_mm, self.model.frame, self.coefficients)[1]
        return np.asarray(-tangent[:2] / tangent[2])

    def gradient(self, xy_mm: Array) -> Array:
        """Derivatives of the height over a point by the coefficients, (count,)."""
        _, tangent, place, depth = self._at(xy_mm, self.model.frame, self.coefficients)
        return np.asarray(-depth / tangent[2] * self.basis.rows(place[None]).matrix()[0])

    def displaced_heights_mm(self, xy_mm: Array) -> Array:
        """Changes of the height over a point under each displaced calibration, (k,)."""
        here = self.height_mm(xy_mm)
        changes = [self._at(xy_mm, rig.frame, self.coefficients + change)[0] - here for rig, change in self.displaced]
        return np.array(changes)

    def points_mm(self, pixels: NDArray[np.integer]) -> Array:
        """Points (n, 3) of M that pixels (n, 2), column and row, see on the surface."""
        return self._seen(pixels, self.model, self.coefficients)

    def _seen(self, pixels: NDArray[np.integer], rig: RigModel, coefficients: Array) -> Array:
        rays = rays_at(rig.intrinsics, pixels)
        depth = 1 / self.basis.rows(rays[:, :2]).inverse_range(coefficients)
        return np.asarray(rig.frame.camera_mm + depth[:, None] * rig.frame.directions(rays))

    def _at(self, xy_mm: Array, frame: ReferenceFrame, coefficients: Array) -> tuple[float, Array, Array, float]:
        """Height, tangent plane in M about the camera, ideal image coordinates, and Z in the camera's frame."""
        x, y = xy_mm - frame.camera_mm[:2]
        z = 0.0
        for _ in range(_MOST_ROUNDS):
            along = np.array([x, y, z - frame.camera_mm[2]]) @ frame.axes
            place = along[:2] / along[2]
            tangent = frame.axes @ self.basis.rows(place[None]).tangents(coefficients)[0]
            before, z = z, frame.camera_mm[2] + (1 - tangent[0] * x - tangent[1] * y) / tangent[2]
            if abs(z - before) < _CLOSE_MM:
                break
        if isinstance(self.basis, Spline) and not self.basis.holds(place):
            raise EvaluationError(
                f"the curved surface ends too far from x {xy_mm[0]:.1f} mm, y {xy_mm[1]:.1f} mm to be continued there"
            )
        return float(z), np.asarray(tangent), place, float(along[2])
