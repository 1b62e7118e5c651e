"""Direction and scale of stage1 in frame M, from what glass and projector show at several of its positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from irpmd_rig.core.errors import CalibrationError

Floats = NDArray[np.float64]

_DEGREE = 6
_FEWEST_PX = 500
_CLIP_SIGMAS = 4.0
_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False)
class StageView:
    """Pixels that see the glass, directly or in the mirror, at one stage position.

    Attributes
    ----------
    stage1_mm : float
        Position s by the stage's own scale.
    directions : ndarray, (n, 3)
        Viewing directions in frame M.
    reflected : ndarray of bool, (n,)
        Whether the glass is seen in the mirror.
    phase_rad : ndarray, (n,)
        Absolute phase along x.
    phase_y_rad : ndarray or None, (n,)
        Along y.
    """

    stage1_mm: float
    directions: Floats
    reflected: NDArray[np.bool_]
    phase_rad: Floats
    phase_y_rad: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StageAxis:
    """How frame M moves as s grows.

    Attributes
    ----------
    positions_mm : tuple of float
        By the stage's own scale.
    displacements_mm : ndarray, (n, 3)
        Of frame M, from the position nearest to 0; by the calibrated geometry's scale.
    axis : ndarray, (3,)
        Unit vector; (0, 0, -1) is along the mirror's normal, away from the glass.
    sigma_rad : tuple of float
        One sigma of its x and y components.
    scale, sigma_scale : float
        Length of the motion over the difference of s, and one sigma.
    rms_rad : float
        What is left of the phases.
    glass : tuple of float
        a, b, c of the plane z = a x + b y + c of the glass that fits best.
    """

    positions_mm: tuple[float, ...]
    displacements_mm: Floats
    axis: Floats
    sigma_rad: tuple[float, float]
    scale: float
    sigma_scale: float
    rms_rad: float
    glass: tuple[float, float, float]

    @property
    def off_line_mm(self) -> Floats:
        """How far the displacements are off the straight line, mm, (n, 3): along the axis the stage's own errors."""
        s = np.array(self.positions_mm)
        origin = s[int(np.argmin(np.abs(s)))]
        return np.asarray(self.displacements_mm - np.outer(s - origin, self.scale * self.axis))


def fit_stage_axis(
    views: Sequence[StageView],
    camera_mm: NDArray[np.floating],
    glass: tuple[float, float, float],
    glass_at_mm: float = 0.0,
) -> StageAxis:
    """Find how frame M moves, from phases that belong to points of the glass, which stands still.

    Parameters
    ----------
    views : sequence of StageView
        At two or more positions.
    camera_mm : ndarray, (3,)
        The camera's centre in frame M, whose plane z = 0 is the mirror.
    glass : tuple of float
        a, b, c of the glass, z = a x + b y + c in frame M: where the search begins.
    glass_at_mm : float
        Position at which it was there.

    Returns
    -------
    StageAxis
        The scale is that of the calibrated geometry, `camera_mm` above all.

    Raises
    ------
    CalibrationError
        Fewer than two positions, or too few pixels at one.

    Notes
    -----
    Whatever projector and glass are, the phase is one smooth function of the point on the glass: here a polynomial of
    degree 6 in x and y, found together with the displacement of every view and the glass's plane. Seen directly and by
    reflection the same points fix that plane; that the camera's rays differ in direction fixes every component of the
    displacements.
    """
    ordered = sorted(views, key=lambda view: abs(view.stage1_mm))
    if len({view.stage1_mm for view in ordered}) < 2:
        raise CalibrationError("the direction of a stage needs two positions at least: give another one")
    for view in ordered:
        if view.phase_rad.size < _FEWEST_PX:
            raise CalibrationError(
                f"at {view.stage1_mm:g} mm only {view.phase_rad.size} pixels see the glass, {_FEWEST_PX} are needed: "
                "check light and placement, or choose a position at which more of it is seen"
            )
    problem = _Problem.of(ordered, np.asarray(camera_mm, dtype=np.float64))
    a, b, c = glass
    # The glass is the farther in M the farther M is from it.
    begin = a, b, c + ordered[0].stage1_mm - glass_at_mm
    start = np.concatenate([begin, *((0.0, 0.0, -(view.stage1_mm - ordered[0].stage1_mm)) for view in ordered[1:])])
    steps = np.concatenate([(1e-3, 1e-3, 1.0), np.ones(3 * (len(ordered) - 1))])
    for _ in range(_ROUNDS):
        found = least_squares(problem.residual, start, x_scale=steps, method="trf")
        start = found.x
        problem = problem.clipped(found.fun)
    found = least_squares(problem.residual, start, x_scale=steps, method="trf")
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / max(found.fun.size - problem.unknowns, 1)
    return _axis(ordered, found.x, covariance, float(np.sqrt(np.mean(found.fun**2))))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Pixels of all views in one list."""

    origins: Floats
    directions: Floats
    view: NDArray[np.intp]
    phases: tuple[Floats, ...]
    keep: NDArray[np.bool_]

    @staticmethod
    def of(views: Sequence[StageView], camera_mm: Floats) -> _Problem:
        with_y = all(view.phase_y_rad is not None for view in views)
        upside = np.array([1.0, 1.0, -1.0])
        flips = [np.where(view.reflected[:, None], upside, 1.0) for view in views]
        phases = [np.concatenate([view.phase_rad for view in views])]
        if with_y:
            phases.append(np.concatenate([view.phase_y_rad for view in views if view.phase_y_rad is not None]))
        return _Problem(
            origins=np.concatenate([camera_mm * flip for flip in flips]),
            directions=np.concatenate([view.directions * flip for view, flip in zip(views, flips, strict=True)]),
            view=np.repeat(np.arange(len(views)), [view.phase_rad.size for view in views]),
            phases=tuple(phases),
            keep=np.ones(phases[0].size, dtype=np.bool_),
        )

    @property
    def unknowns(self) -> int:
        terms = (_DEGREE + 1) * (_DEGREE + 2) // 2
        return 3 * int(self.view.max() + 1) + terms * len(self.phases)

    def residual(self, parameters: Floats) -> Floats:
        """What the best polynomials leave of the phases, rad; zero where clipped."""
        (a, b, c), moves = parameters[:3], np.vstack([np.zeros(3), parameters[3:].reshape(-1, 3)])
        origins = self.origins + moves[self.view]
        slope = np.array([-a, -b, 1.0])
        reach = (c - origins @ slope) / (self.directions @ slope)
        points = origins + reach[:, None] * self.directions
        design = _powers(points[:, 0], points[:, 1])
        phases = np.stack(self.phases, axis=1)
        kept = design[self.keep]
        # Chebyshev terms over their own range are independent enough for normal equations.
        coefficients = np.linalg.solve(kept.T @ kept, kept.T @ phases[self.keep])
        left = np.where(self.keep[:, None], phases - design @ coefficients, 0.0)
        return np.asarray(left.T.reshape(-1))

    def clipped(self, residual: Floats) -> _Problem:
        """Leave out pixels of the surface's rims and specks, where another phase is seen."""
        parts = np.abs(residual.reshape(len(self.phases), -1))
        spread = 1.4826 * np.median(parts[:, self.keep], axis=1, keepdims=True)
        good = (parts <= np.maximum(_CLIP_SIGMAS * spread, 1e-9)).all(axis=0)
        return _Problem(self.origins, self.directions, self.view, self.phases, self.keep & good)


def _powers(x_mm: Floats, y_mm: Floats) -> Floats:
    """Chebyshev terms up to the degree over the points' own range."""
    x, y = (2 * (value - value.min()) / np.ptp(value) - 1 for value in (x_mm, y_mm))
    in_x, in_y = (np.polynomial.chebyshev.chebvander(value, _DEGREE) for value in (x, y))
    return np.stack([in_x[:, i] * in_y[:, j] for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=1)


def _axis(views: Sequence[StageView], found: Floats, covariance: Floats, rms_rad: float) -> StageAxis:
    s = np.array([view.stage1_mm for view in views])
    far = s[1:] - s[0]
    moves = np.vstack([np.zeros(3), found[3:].reshape(-1, 3)])
    # The line through the position nearest to 0: least squares with the weight of the way.
    mixing = np.kron(far / (far @ far), np.eye(3))
    drift, drift_covariance = mixing @ found[3:], mixing @ covariance[3:, 3:] @ mixing.T
    scale = float(np.linalg.norm(drift))
    axis = drift / scale
    across = (np.eye(3) - np.outer(axis, axis)) / scale
    spread = np.sqrt(np.diag(across @ drift_covariance @ across.T))
    a, b, c = (float(value) for value in found[:3])
    return StageAxis(
        positions_mm=tuple(float(value) for value in s),
        displacements_mm=moves,
        axis=axis,
        sigma_rad=(float(spread[0]), float(spread[1])),
        scale=scale,
        sigma_scale=float(np.sqrt(axis @ drift_covariance @ axis)),
        rms_rad=rms_rad,
        glass=(a, b, c),
    )
