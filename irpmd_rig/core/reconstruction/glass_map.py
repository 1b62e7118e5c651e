"""Where on the glass a phase is shown, tabulated as polynomials: what the projector's model cannot say in closed form.

The column planes of a projector meet the glass in nearly parallel lines. A coordinate sheared along them,
x' = x - shear y, depends on the phase almost alone; what is left of y (keystone, lens) is micrometres a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]

DEGREE = 7
"""Total degree of the polynomials: a lens of 0.3 % distortion, turned by a degree, is met to 2e-8 mm."""

_SAMPLES = 24
_COARSE_DEGREE = 3
# How far the projector's picture reaches across is no more than assumed where only fringes along x were calibrated;
# much farther out the polynomials mean nothing.
_REACH = 2.0
_LOOKED_AT = 9
_NEWTON_ROUNDS = 12
_STEP_MM = 1e-3
_SETTLED_MM = 1e-9


@dataclass(frozen=True, slots=True)
class GlassMap:
    """Place on the glass's plane, in frame M at s = 0, from an absolute phase and the coordinate across.

    Along x: x = shear y + sum c[j, i] v^j u^i with u of the phase, v of y, both -1..1 over the projector's picture.
    Along y x and y change places.

    Attributes
    ----------
    along_rad, across_mm : tuple of float
        Centre and half the width of what u and v map to -1..1.
    shear : float
        Slope of the lines of equal phase against the axis across.
    place_mm : ndarray, (DEGREE + 1, DEGREE + 1)
        The coefficients c; zero where i + j > DEGREE.
    coarse_mm : ndarray, (4, 4)
        As `place_mm`, of degree 3: right to micrometres.
    lift : ndarray, (DEGREE + 1, DEGREE + 1)
        As `place_mm`, for the change of the place with the height of the glass, for a glass that is no plane.
    """

    along_rad: tuple[float, float]
    across_mm: tuple[float, float]
    shear: float
    place_mm: Array
    coarse_mm: Array
    lift: Array

    @property
    def mm_per_rad(self) -> float:
        """Distance on the glass along the axis for a radian, in the middle of the picture."""
        return float(abs(self.place_mm[0, 1]) / self.along_rad[1])

    @property
    def skew(self) -> float:
        """Largest change of the place for a step across, along lines of equal phase that are sheared straight."""
        change = np.polynomial.polynomial.polyder(self.place_mm, axis=0) / self.across_mm[1]
        u, v = np.meshgrid(*(np.linspace(-1.0, 1.0, _LOOKED_AT),) * 2)
        return float(np.abs(np.polynomial.polynomial.polyval2d(v, u, change)).max())

    def within(self, across_mm: Array) -> Array:
        """Give the coordinate across, or the end of the map where it lies beyond."""
        middle, half = self.across_mm
        return np.clip(across_mm, middle - _REACH * half, middle + _REACH * half)

    def value(self, coefficients: Array, phase_rad: Array, across_mm: Array) -> Array:
        """Value of `place_mm` or `lift`."""
        u = (phase_rad - self.along_rad[0]) / self.along_rad[1]
        v = (across_mm - self.across_mm[0]) / self.across_mm[1]
        return np.asarray(np.polynomial.polynomial.polyval2d(v, u, coefficients))


def tabulate(model: RigModel, axis: int = 0) -> GlassMap:
    """Polynomials of the glass's plane for the phase along x (axis 0) or y (axis 1).

    Parameters
    ----------
    model : RigModel
        The calibrated rig; `bow_mm` and `correction_rad` are left out.
    axis : int
        0: phase along x, which fixes x given y; 1: phase along y, which fixes y given x.

    Raises
    ------
    CalibrationError
        If the model's projector does not light the glass, or so obliquely that polynomials do not describe it.
    """
    light = _Light(model, axis)
    along = _interval(np.array([0.0, 2 * np.pi * model.count]))
    across = _interval(light.corners_mm[:, 1 - axis])
    nodes = np.cos(np.pi * (np.arange(_SAMPLES) + 0.5) / _SAMPLES)
    u, v = (grid.ravel() for grid in np.meshgrid(nodes, nodes))
    phase, beside = along[0] + along[1] * u, across[0] + across[1] * v
    place = light.place_mm(phase, beside, 0.0)
    lift = light.place_mm(phase, beside, 0.5) - light.place_mm(phase, beside, -0.5)
    coefficients, misfit = _fit(u, v, place)
    if not misfit < 1e-3 * np.ptp(place):
        raise CalibrationError("the projector of this calibration lights the glass too obliquely: calibrate anew")
    shear = float(powers(coefficients)[1, 0] / across[1])
    # Of Chebyshev polynomials the first few are nearly the best of their degree.
    coefficients[:2, 0] -= shear * across[0], shear * across[1]
    few = _COARSE_DEGREE + 1
    coarse = np.where(np.add.outer(range(few), range(few)) < few, coefficients[:few, :few], 0.0)
    return GlassMap(along, across, shear, powers(coefficients), powers(coarse), powers(_fit(u, v, lift)[0]))


class _Light:
    """The projector's light on the glass's plane."""

    def __init__(self, model: RigModel, axis: int) -> None:
        self._model, self._axis = model, axis
        projector = model.projector
        (width, height), (fx, fy), (cx, cy) = projector.size_px, projector.focal_px, projector.principal_point_px
        pixels = np.array([[x, y] for x in (-0.5, width - 0.5) for y in (-0.5, height - 0.5)])
        directions = np.column_stack([(pixels[:, 0] - cx) / fx, (pixels[:, 1] - cy) / fy, np.ones(4)]) @ projector.axes
        a, b, c = model.glass
        normal = np.array([-a, -b, 1.0])
        reach = (c - projector.centre_mm @ normal) / (directions @ normal)
        if not (reach > 0).all():
            raise CalibrationError("the projector of this calibration does not shine onto the glass: calibrate anew")
        # Where the corners of the picture, without the lens's distortion, meet the glass.
        self.corners_mm = projector.centre_mm + reach[:, None] * directions

    def place_mm(self, phase_rad: Array, across_mm: Array, lifted_mm: float) -> Array:
        """Coordinate along the axis at which a glass lifted by so much shows a phase, by Newton's method."""
        along = np.full(np.shape(phase_rad), float(self.corners_mm[:, self._axis].mean()))
        for _ in range(_NEWTON_ROUNDS):
            here, ahead = (self._phase_rad(along + step, across_mm, lifted_mm) for step in (0.0, _STEP_MM))
            step = (phase_rad - here) / (ahead - here) * _STEP_MM
            along = along + step
            if np.abs(step).max() < _SETTLED_MM:
                break
        return along

    def _phase_rad(self, along_mm: Array, across_mm: Array, lifted_mm: float) -> Array:
        x, y = (along_mm, across_mm) if self._axis == 0 else (across_mm, along_mm)
        a, b, c = self._model.glass
        points = np.stack([x, y, a * x + b * y + c + lifted_mm], axis=-1)
        if self._axis == 1:
            return self._model.phase_y_rad(points)
        return self._model.phase_rad(points, on_glass=False)


def _interval(values: Array) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return (low + high) / 2, (high - low) / 2


def _fit(u: Array, v: Array, values: Array) -> tuple[Array, float]:
    """Coefficients of T_j(v) T_i(u), and the largest misfit."""
    basis_u, basis_v = (np.polynomial.chebyshev.chebvander(t, DEGREE) for t in (u, v))
    pairs = [(j, i) for j in range(DEGREE + 1) for i in range(DEGREE + 1 - j)]
    design = np.stack([basis_v[:, j] * basis_u[:, i] for j, i in pairs], axis=1)
    solution, *_ = np.linalg.lstsq(design, values, rcond=None)
    coefficients = np.zeros((DEGREE + 1, DEGREE + 1))
    for pair, value in zip(pairs, solution, strict=True):
        coefficients[pair] = value
    return coefficients, float(np.abs(design @ solution - values).max())


def powers(chebyshev: Array) -> Array:
    """Coefficients of x^j y^i from those of T_j(x) T_i(y)."""
    changes = []
    for size in chebyshev.shape:
        change = np.zeros((size, size))
        for n in range(size):
            change[n, : n + 1] = np.polynomial.chebyshev.cheb2poly(np.eye(size)[n, : n + 1])
        changes.append(change)
    return np.asarray(changes[0].T @ chebyshev @ changes[1])
