"""The self-calibrated rig: where camera, glass, stage axis and projector are, and the phase that any point shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.camera import Intrinsics, rays
from irpmd_rig.core.frame import ReferenceFrame

Array = NDArray[np.float64]
_BOW_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Projector:
    """Pinhole and Brown distortion of the projector.

    Attributes
    ----------
    size_px : tuple of int
        Columns and rows.
    axes : ndarray, (3, 3)
        Rows are the directions of growing column, of growing row, and of view, in frame M at s = 0.  A left-handed
        set is a mirrored picture.
    centre_mm : ndarray, (3,)
        Centre of projection in the same frame.
    focal_px : tuple of float
        fx, fy, px.
    principal_point_px : tuple of float
        cx, cy, px; the centre of the first pixel is (0, 0).
    distortion : tuple of float
        k1, k2, p1, p2, k3 in OpenCV's convention, for normalised coordinates.
    """

    size_px: tuple[int, int]
    axes: Array
    centre_mm: Array
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def pixels(self, points_mm: Array) -> Array:
        """Column and row, (..., 2), px, that light points (..., 3) of frame M at s = 0."""
        along = (points_mm - self.centre_mm) @ self.axes.T
        x, y = along[..., 0] / along[..., 2], along[..., 1] / along[..., 2]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        (fx, fy), (cx, cy) = self.focal_px, self.principal_point_px
        column = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
        row = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
        return np.stack([column, row], axis=-1)


@dataclass(frozen=True, slots=True)
class Correction:
    """A smooth function over the glass that the parameters of the model cannot express; zero where empty.

    Attributes
    ----------
    x_mm, y_mm : tuple of float
        Domain in x and y of frame M at s = 0, mapped to -1..1; beyond it the edge's value holds.
    coefficients : ndarray, (m, n)
        Of Chebyshev polynomials T_i(x) T_j(y).
    """

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]
    coefficients: Array

    def __call__(self, x_mm: Array, y_mm: Array) -> Array:
        """Value at points of the glass."""
        x, y = (
            np.clip((2 * value - low - high) / (high - low), -1.0, 1.0)
            for value, (low, high) in ((x_mm, self.x_mm), (y_mm, self.y_mm))
        )
        return np.asarray(np.polynomial.chebyshev.chebval2d(x, y, self.coefficients))


@dataclass(frozen=True, slots=True)
class RigModel:
    """Everything that tells the phase a camera pixel shows from the surface that it sees.

    Frame M rides on stage1 with camera and mirror; glass and projector stand still, and are given in M at s = 0.

    Attributes
    ----------
    intrinsics : Intrinsics
        The camera's.
    frame : ReferenceFrame
        The camera's place in M.
    glass : tuple of float
        a, b, c of the glass, z = a x + b y + c + `bow_mm`.
    stage_axis : ndarray, (3,)
        Unit vector in M along which M moves as s grows (AWAY from the glass: about (0, 0, -1)).
    projector : Projector
        The projector.
    count : float
        Fringe count to which absolute phases belong: the finest set's.
    bow_mm : Correction or None
        What the glass adds to its plane, mm.
    correction_rad : Correction or None
        What the glass adds to the phase along x, rad.
    """

    intrinsics: Intrinsics
    frame: ReferenceFrame
    glass: tuple[float, float, float]
    stage_axis: Array
    projector: Projector
    count: float
    bow_mm: Correction | None = None
    correction_rad: Correction | None = None

    def directions(self) -> Array:
        """Viewing directions of all pixels in M, (H, W, 3); not normalised."""
        return self.frame.directions(rays(self.intrinsics))

    def still(self, points_mm: Array, s_mm: float) -> Array:
        """Points (..., 3) of M at stage position s, in M at s = 0, where glass and projector stand still."""
        return points_mm + s_mm * self.stage_axis

    def glass_z_mm(self, x_mm: Array, y_mm: Array) -> Array:
        """Height of the glass over M at s = 0."""
        a, b, c = self.glass
        plane = a * x_mm + b * y_mm + c
        return plane if self.bow_mm is None else plane + self.bow_mm(x_mm, y_mm)

    def meet_glass(self, points_mm: Array, directions: Array) -> Array:
        """Where lines meet the glass: points (..., 3) of M at s = 0, from points that stand still and directions."""
        a, b, c = self.glass
        x, y, z = (points_mm[..., axis] for axis in range(3))
        gap = c + a * x + b * y - z
        closing = directions[..., 2] - a * directions[..., 0] - b * directions[..., 1]
        met = points_mm + (gap / closing)[..., None] * directions
        if self.bow_mm is not None:
            # The bow's slope is far below 1e-2: every round gains that factor.
            for _ in range(_BOW_ROUNDS):
                bowed = gap + self.bow_mm(met[..., 0], met[..., 1])
                met = points_mm + (bowed / closing)[..., None] * directions
        return np.asarray(met)

    def phase_rad(self, points_mm: Array, *, on_glass: bool) -> Array:
        """Absolute phase along x that the projector gives points (..., 3) of M at s = 0.

        Parameters
        ----------
        points_mm : ndarray, (..., 3)
            Points that stand still.
        on_glass : bool
            Whether they lie on the glass, to which `correction_rad` belongs.
        """
        column = self.projector.pixels(points_mm)[..., 0]
        phase = np.asarray(2 * np.pi * self.count * (column + 0.5) / self.projector.size_px[0])
        if on_glass and self.correction_rad is not None:
            phase = phase + self.correction_rad(points_mm[..., 0], points_mm[..., 1])
        return phase

    def phase_y_rad(self, points_mm: Array) -> Array:
        """Absolute phase along y: as `phase_rad`, of the same count over the projector's rows."""
        row = self.projector.pixels(points_mm)[..., 1]
        return np.asarray(2 * np.pi * self.count * (row + 0.5) / self.projector.size_px[1])
