"""Robust least-squares fit of the rig's numbers to the cells' phases."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.self_cells import Cells
from irpmd_rig.core.calibration.self_paths import lit_points, modelled_phase, phase_at
from irpmd_rig.core.calibration.self_prior import INTRINSICS
from irpmd_rig.core.calibration.self_unknowns import PLACES, RIG, Unknowns
from irpmd_rig.core.camera import Intrinsics, rays_at

Array = NDArray[np.float64]

_TRIES = 12
_DAMPING = 1e-6
# Share of its own sigma by which a number may still move.
_CONVERGED = 0.03
# Fall of the sum of squares, in units of the noise, that changes nothing; and the damping up to which a step is free.
_IDLE = 0.3
_DAMPED = 1e-3
_STEP_SHARE = 1e-4  # of a number's weak sigma, for derivatives
_STEP_RAY = 1e-5
_STEP_STAGE_MM = 1e-2
# Huber's threshold, in robust standard deviations.
_HUBER = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Result of `fit_unknowns`.

    Attributes
    ----------
    values : ndarray, (P,)
        Of the unknowns.
    data_root, prior_root : ndarray, (P, P)
        Roots of the information that the cells and the assumptions before them have of the values.
    residual : ndarray, (n,)
        Measured minus modelled, in sigmas of each cell.
    weight : ndarray, (n,)
        1, or less for outlying cells.
    settled : bool
        Whether nothing moves any more; else the rounds did not suffice.
    """

    values: Array
    data_root: Array
    prior_root: Array
    residual: Array
    weight: Array
    settled: bool

    def covariance(self, inflation: float = 1.0) -> Array:
        """Covariance (P, P) of the values where the cells' variances are this much larger than stated."""
        return _inverse_square(np.concatenate([self.data_root / np.sqrt(inflation), self.prior_root]))

    @property
    def degrees_of_freedom(self) -> float:
        """Number of cells without those that the values use up."""
        kept = np.trace(self.covariance() @ self.prior_root.T @ self.prior_root)
        return float(len(self.residual) - len(self.values) + kept)

    @property
    def chi2_per_dof(self) -> float:
        """Weighted squares of the residuals, a degree of freedom."""
        return float(np.sum(self.weight * self.residual**2) / max(self.degrees_of_freedom, 1.0))


def fit_unknowns(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array, rounds: int = 30) -> Fit:
    """Values that describe the cells best, the weak assumptions included.

    Parameters
    ----------
    cells : Cells
        n of them.
    stage_mm : ndarray, (n,)
        Stage position of each cell, as read.
    unknowns : Unknowns
        P numbers.
    values : ndarray, (P,)
        Where to begin.
    rounds : int
        At most so many steps.

    Notes
    -----
    Levenberg and Marquardt; the linear systems are solved by QR, as normal equations would square a condition
    that is bad by nature (a micrometre here, a projector's place to decimetres there). Huber's weights about the
    residuals' median absolute size.
    """
    prior = unknowns.prior_root
    damping = _DAMPING
    residual = _residual(cells, stage_mm, unknowns, values)
    for _ in range(rounds):
        weight, scale = _huber(residual)
        root = np.sqrt(weight)
        data = root[:, None] * _jacobian(cells, stage_mm, unknowns, values) / cells.sigma_rad[:, None]
        data_root, turned = _condensed(data, root * residual)
        # Far off, residuals are larger than the stated noise, and count less against what is assumed.
        system = np.concatenate([data_root, scale * prior])
        right = np.concatenate([turned, scale * prior @ (unknowns.start - values)])
        cost = np.sum((root * residual) ** 2) + np.sum(right[len(turned) :] ** 2)
        sigmas = scale * np.sqrt(np.diag(_inverse_square(system)))
        for _ in range(_TRIES):
            step = _damped(system, right, damping)
            pull = scale * prior @ (unknowns.start - values - step)
            ahead = _residual(cells, stage_mm, unknowns, values + step)
            better = np.sum((root * ahead) ** 2) + pull @ pull
            small = bool(np.max(np.abs(step) / sigmas) < _CONVERGED)
            if better <= cost or small:
                break
            damping *= 10
        values, residual = values + step, ahead
        # Along a curved valley of numbers that the data hardly know the squares fall a little for ever. A step that is
        # small because it is damped is no end.
        idle = abs(cost - better) < _IDLE * scale**2
        settled = bool((small or idle) and damping <= _DAMPED)
        damping /= 10
        if small or settled:
            break
    return Fit(values, data_root, prior, residual, weight, settled)


def weighted_squares(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array) -> Array:
    """Squares of the residuals, (n,), in units of each cell's variance, outliers weighted down as in a fit.

    Parameters as for `fit_unknowns`.
    """
    residual = _residual(cells, stage_mm, unknowns, values)
    return np.asarray(_huber(residual)[0] * residual**2)


def _condensed(system: Array, right: Array) -> tuple[Array, Array]:
    """Least-squares system (P, P) with the solution of a tall one."""
    orthogonal, triangle = np.linalg.qr(system)
    return triangle, orthogonal.T @ right


def _damped(system: Array, right: Array, damping: float) -> Array:
    """Levenberg and Marquardt's step."""
    unit = 1 / np.linalg.norm(system, axis=0)
    size = len(unit)
    tall = np.concatenate([system * unit, np.sqrt(damping) * np.eye(size)])
    solution, *_ = np.linalg.lstsq(tall, np.concatenate([right, np.zeros(size)]), rcond=None)
    return np.asarray(unit * solution)


def _inverse_square(root: Array) -> Array:
    """Inverse of root^T root."""
    unit = 1 / np.linalg.norm(root, axis=0)
    inverse = unit[:, None] * np.linalg.inv(np.linalg.qr(root * unit, mode="r"))
    return np.asarray(inverse @ inverse.T)


def _huber(residual: Array) -> tuple[Array, float]:
    """Weights, and the residuals' robust standard deviation (at least 1: the stated noise)."""
    scale = max(1.4826 * float(np.median(np.abs(residual))), 1.0)
    return np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(residual), 1e-300)), scale


def _positions(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array) -> Array:
    return np.asarray(stage_mm + values[unknowns.offsets][cells.view])


def _residual(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array) -> Array:
    model = unknowns.model(values)
    rays = rays_at(model.intrinsics, cells.pixel)
    positions = _positions(cells, stage_mm, unknowns, values)
    phase = modelled_phase(model, cells, rays, positions)
    return np.asarray((cells.phase_rad - phase) / cells.sigma_rad)


def _jacobian(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array) -> Array:
    """Derivatives, (n, P), of the modelled phases: central differences but for intrinsics and free-form terms."""
    model = unknowns.model(values)
    rays = rays_at(model.intrinsics, cells.pixel)
    positions = _positions(cells, stage_mm, unknowns, values)
    jacobian = np.zeros((len(cells), len(values)))
    points = lit_points(model, cells, rays, positions)
    for place in range(INTRINSICS, len(RIG)):
        step = np.zeros(len(values))
        step[place] = _STEP_SHARE * RIG[place].weak_sigma
        ahead, behind = (unknowns.model(values + sign * step) for sign in (1, -1))
        if RIG[place].name.startswith("projector"):
            difference = phase_at(ahead, cells, points) - phase_at(behind, cells, points)
        else:
            difference = modelled_phase(ahead, cells, rays, positions) - modelled_phase(behind, cells, rays, positions)
        jacobian[:, place] = difference / (2 * step[place])
    by_ray = np.empty((len(cells), 2))
    for axis in range(2):
        aside = _STEP_RAY * np.eye(3)[axis]
        right, left = (modelled_phase(model, cells, rays + sign * aside, positions) for sign in (1, -1))
        by_ray[:, axis] = (right - left) / (2 * _STEP_RAY)
    jacobian[:, :INTRINSICS] = np.einsum("nr,nrp->np", by_ray, _ray_by_intrinsics(model.intrinsics, rays))
    away, toward = (modelled_phase(model, cells, rays, positions + sign * _STEP_STAGE_MM) for sign in (1, -1))
    by_stage = (away - toward) / (2 * _STEP_STAGE_MM)
    jacobian[np.arange(len(cells)), unknowns.offsets.start + cells.view] = by_stage
    if unknowns.freeform is not None:
        by_height = jacobian[:, PLACES["glass.height"]]
        jacobian[:, unknowns.coefficients] = unknowns.freeform.design(points, cells.axis == 0, by_height)
    return jacobian


def _ray_by_intrinsics(intrinsics: Intrinsics, rays: Array) -> Array:
    """Derivatives, (n, 2, 8), of x/z and y/z of fixed pixels' rays with fx, fy, cx, cy, k1, k2, p1, p2."""
    still = np.zeros(3)
    _, jacobian = cv2.projectPoints(rays, still, still, intrinsics.matrix, np.array(intrinsics.distortion))
    jacobian = jacobian.reshape(len(rays), 2, -1)
    # The pixel stays: what the intrinsics would move, the ray (that is, the point at distance 1) has to undo.
    return np.asarray(-np.linalg.solve(jacobian[:, :, 3:5], jacobian[:, :, 6 : 6 + INTRINSICS]))
