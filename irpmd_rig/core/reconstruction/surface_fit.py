"""Maximum-likelihood surface of one facet from all its phases at all stage positions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.planes import correlation_inflation
from irpmd_rig.core.reconstruction.freeform import FREE, Array, Basis
from irpmd_rig.core.reconstruction.reflected_phase import reflected_phase, reflected_phase_and_gradient
from irpmd_rig.core.rig_model import RigModel

_CLIP_SIGMAS = 5.0
_MOST_ROUNDS = 12
# A round that lowers chi2 by less than this has nothing left to gain against a standard deviation's 1.
_SETTLED = 1e-2
# Residuals below this part of a sigma are rounding, not outliers: of phases without noise.
_LEAST_SPREAD = 1e-6
# Smoothing against the data's weight: with less, the equations could not be solved where there are no data, with
# more, not for the cubics that the data determine.
_SMOOTHING = (1e-9, 1e4)
_ALIKE = 0.05  # relative change of the smoothing that changes nothing worth another solution
# Nodes, in standard deviations, and weights of a normal distribution's mean.
_BLUR_NODES = ((-np.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (np.sqrt(3.0), 1 / 6))


@dataclass(frozen=True, slots=True)
class Showing:
    """One map of phases of a facet.

    Attributes
    ----------
    position_mm : float
        Position of stage1.
    along_y : bool
        Whether it is the phase along y.
    phase_rad, weight : ndarray, (n,)
        Phase of each pixel, and 1 / sigma; weight 0 where it is unknown.
    """

    position_mm: float
    along_y: bool
    phase_rad: Array
    weight: Array


@dataclass(frozen=True, slots=True)
class FacetPixels:
    """The pixels of one facet and all that is known of them.

    Attributes
    ----------
    pixels : ndarray of int, (n, 2)
        Column and row in the camera's picture.
    rays : ndarray, (n, 3)
        In the camera's frame, third component 1.
    showings : tuple of Showing
        One a view, or two with phases along y.
    inverse_range, inverse_sigma : ndarray, (n,)
        1 / Z of the triangulated depth and its sigma, 1/mm.
    """

    pixels: NDArray[np.int64]
    rays: Array
    showings: tuple[Showing, ...]
    inverse_range: Array
    inverse_sigma: Array

    @property
    def places(self) -> Array:
        """Ideal image coordinates, (n, 2)."""
        return self.rays[:, :2]

    @property
    def linear(self) -> Array:
        """1, x, y, (n, 3), from the middle of the facet and in units of its half: what tells planes apart."""
        low, high = self.places.min(axis=0), self.places.max(axis=0)
        scaled = (self.places - (low + high) / 2) / ((high - low).max() / 2)
        return np.concatenate([np.ones((len(scaled), 1)), scaled], axis=1)

    def some(self, most: int) -> FacetPixels:
        """About as many pixels as said at most, evenly among all."""
        few = slice(None, None, -(-len(self.pixels) // most))
        showings = tuple(Showing(s.position_mm, s.along_y, s.phase_rad[few], s.weight[few]) for s in self.showings)
        return FacetPixels(self.pixels[few], self.rays[few], showings, self.inverse_range[few], self.inverse_sigma[few])


@dataclass(frozen=True, slots=True)
class SurfaceFit:
    """Coefficients of a surface and how well it describes the phases.

    Attributes
    ----------
    coefficients : ndarray, (count,)
        Of the basis.
    covariance : ndarray, (count, count)
        By the noise; inflated where residuals are larger than stated or hang together.
    smoothing : float
        Weight of the basis's roughness.
    chi2_per_dof : float
        Of the phases' residuals against their stated noise.
    coherence : float
        Variance of means over blocks of pixels against that of independent residuals, at least 1.
    """

    coefficients: Array
    covariance: Array
    smoothing: float
    chi2_per_dof: float
    coherence: float


def start_from_depth(facet: FacetPixels, basis: Basis) -> tuple[Array, float]:
    """Coefficients through the triangulated depth alone, and their smoothing."""
    rows = basis.rows(facet.places)
    weight = 1 / facet.inverse_sigma
    for _ in range(2):
        weighted = rows.value * weight[:, None]
        slope = rows.slope(weighted, weight * facet.inverse_range)
        coefficients, smoothing = _smoothed(rows.normal(weighted), slope, basis.roughness())
        pull = np.abs(rows.inverse_range(coefficients) - facet.inverse_range) / facet.inverse_sigma
        weight = weight * (pull <= _CLIP_SIGMAS * max(1.4826 * float(np.median(pull)), _LEAST_SPREAD))
    return coefficients, smoothing


def fit_surface(
    facet: FacetPixels, model: RigModel, basis: Basis, start: tuple[Array, float], *, psf_px: float = 0.0
) -> SurfaceFit:
    """Fit a surface to the phases of a facet by Gauss-Newton, outliers clipped.

    Parameters
    ----------
    facet : FacetPixels
        Its phases.
    model : RigModel
        The calibrated rig.
    basis : Basis
        What surfaces there are.
    start : tuple
        Coefficients and smoothing from `start_from_depth`.
    psf_px : float
        RMS width of the camera's blur, which moves the phase where it is curved over the picture; 0: none.

    Returns
    -------
    SurfaceFit
        See there.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the phases do not determine the surface.

    Notes
    -----
    All positions and normals enter by the phases themselves, so each counts by its own weight (physics notes,
    section 5). The smoothing of a spline is estimated with it: the prior variance of its fourth differences is the
    one that the data show (restricted maximum likelihood, Schall 1991, Biometrika 78, 719).
    """
    rows, penalty = basis.rows(facet.places), basis.roughness()
    coefficients, smoothing = start
    blurred = [np.zeros(len(facet.pixels)) for _ in facet.showings]
    for round_ in range(_MOST_ROUNDS):
        normal, slope = np.zeros((basis.count, basis.count)), np.zeros(basis.count)
        tangents = rows.tangents(coefficients)
        pulls = []
        if psf_px > 0 and round_ in (1, 3):
            blurred = [_blur_rad(facet, model, basis, coefficients, showing, psf_px) for showing in facet.showings]
        for showing, shift in zip(facet.showings, blurred, strict=True):
            phase, gradient = reflected_phase_and_gradient(
                model, facet.rays, tangents, showing.position_mm, along_y=showing.along_y
            )
            pull, weight = _clipped((showing.phase_rad - phase - shift) * showing.weight, showing.weight)
            pulls.append(pull)
            jacobian = rows.by_coefficients(gradient * weight[:, None])
            normal += rows.normal(jacobian)
            slope += rows.slope(jacobian, np.nan_to_num(pull))
        if not np.isfinite(normal).all():
            raise np.linalg.LinAlgError("the fit diverged")
        fresh, smoothing = _smoothed(normal, slope + normal @ coefficients, penalty, (coefficients, smoothing))
        change, coefficients = fresh - coefficients, fresh
        if float(change @ normal @ change) < _SETTLED and (psf_px == 0 or round_ > 3):
            break
    return _described(facet, normal, penalty, pulls, (coefficients, smoothing))


def _described(
    facet: FacetPixels, normal: Array, penalty: Array | None, pulls: list[Array], solution: tuple[Array, float]
) -> SurfaceFit:
    coefficients, smoothing = solution
    inverse = _inverse(normal if penalty is None else normal + smoothing * penalty)
    used = sum(int(np.isfinite(pull).sum()) for pull in pulls)
    chi2 = sum(float(np.nansum(pull**2)) for pull in pulls) / max(used - float(np.sum(inverse * normal)), 1.0)
    columns, rows = facet.pixels.T
    # A facet may show no phase at one of several positions.
    coherence = max(
        (
            correlation_inflation(rows[known], columns[known], pull[known])
            for pull in pulls
            for known in [np.isfinite(pull)]
            if known.any()
        ),
        default=1.0,
    )
    return SurfaceFit(coefficients, inverse * max(chi2, 1.0) * coherence, smoothing, chi2, coherence)


def displacement(
    facet: FacetPixels, fitted: tuple[Basis, Array, float], model: RigModel, changed: list[tuple[RigModel, Array]]
) -> tuple[Array, Array]:
    """What a fit and the triangulated piston would change by if the rig were another one; linear.

    Parameters
    ----------
    facet : FacetPixels
        A few of a facet's pixels (`FacetPixels.some`).
    fitted : tuple
        Basis, coefficients and smoothing, the latter weighed for so few pixels.
    model : RigModel
        The rig with which it was fitted.
    changed : list of tuple
        Other rigs, each with what is added to the stage position of each showing, mm.

    Returns
    -------
    ndarray, (k, count)
        Change of the coefficients with each.
    ndarray, (k, 3)
        Change of the moments of the triangulated 1 / Z (`FacetPixels.linear`).
    """
    basis, coefficients, smoothing = fitted
    rows, penalty = basis.rows(facet.places), basis.roughness()
    tangents = rows.tangents(coefficients)
    normal = np.zeros((basis.count, basis.count))
    phases, jacobians, gradients = [], [], []
    for showing in facet.showings:
        phase, gradient = reflected_phase_and_gradient(
            model, facet.rays, tangents, showing.position_mm, along_y=showing.along_y
        )
        jacobian = rows.by_coefficients(gradient * showing.weight[:, None])
        normal += rows.normal(jacobian)
        phases.append(phase)
        gradients.append(gradient)
        jacobians.append(jacobian)
    inverse = _inverse(normal if penalty is None else normal + smoothing * penalty)
    pixelwise = _pixelwise(facet, gradients)
    moved, moments = [], []
    for other, offsets_mm in changed:
        rays = rays_at(other.intrinsics, facet.pixels)
        seen = basis.rows(rays[:, :2]).tangents(coefficients)
        misfits = [
            phase - reflected_phase(other, rays, seen, showing.position_mm + offset, along_y=showing.along_y)
            for showing, phase, offset in zip(facet.showings, phases, offsets_mm, strict=True)
        ]
        pairs = zip(jacobians, misfits, facet.showings, strict=True)
        moved.append(inverse @ sum(rows.slope(jacobian, misfit * s.weight) for jacobian, misfit, s in pairs))
        change = (pixelwise * np.stack(misfits, axis=1)).sum(axis=1)
        moments.append(np.nanmean(change[:, None] * facet.linear, axis=0))
    return np.array(moved).reshape(-1, basis.count), np.array(moments).reshape(-1, 3)


def blur_of_range(facet: FacetPixels, model: RigModel, basis: Basis, coefficients: Array, psf_px: float) -> Array:
    """What the camera's blur adds to the triangulated 1 / Z of each pixel of a curved surface, (n,), 1/mm.

    On a sphere of radius 100 it lowers the depth by micrometres (physics notes, section 5).
    """
    tangents = basis.rows(facet.places).tangents(coefficients)
    gradients = [
        reflected_phase_and_gradient(model, facet.rays, tangents, showing.position_mm, along_y=showing.along_y)[1]
        for showing in facet.showings
    ]
    shifts = [_blur_rad(facet, model, basis, coefficients, showing, psf_px) for showing in facet.showings]
    return np.asarray(np.nan_to_num((_pixelwise(facet, gradients) * np.stack(shifts, axis=1)).sum(axis=1)))


def _pixelwise(facet: FacetPixels, gradients: list[Array]) -> Array:
    """Derivatives, (n, showings), of each pixel's own w by its phases: by triangulation, the y slope held if it is."""
    gradient = np.stack(gradients, axis=1) * np.stack([s.weight for s in facet.showings], axis=1)[..., None]
    x, y = facet.places[:, 0, None], facet.places[:, 1, None]
    by_w, by_x, by_y = (
        gradient[..., 2],
        gradient[..., 0] - x * gradient[..., 2],
        gradient[..., 1] - y * gradient[..., 2],
    )
    free = [by_w, by_x, by_y] if any(s.along_y for s in facet.showings) else [by_w, by_x]
    design = np.stack(free, axis=2)
    design[(design != 0).any(axis=2).sum(axis=1) < len(free)] = np.nan
    normal = np.einsum("nki,nkj->nij", design, design)
    known = np.isfinite(normal).all(axis=(1, 2))
    result = np.full(gradient.shape[:2], np.nan)
    solved = np.linalg.solve(normal[known], design[known].transpose(0, 2, 1))[:, 0]
    result[known] = solved * np.stack([s.weight for s in facet.showings], axis=1)[known]
    return result


def _clipped(pull: Array, weight: Array) -> tuple[Array, Array]:
    """Residuals in sigmas, NaN where unknown or an outlier, and the weights with zeros there."""
    known = weight > 0
    spread = 1.4826 * float(np.median(np.abs(pull[known]))) if known.any() else 0.0
    used = known & (np.abs(pull) <= _CLIP_SIGMAS * max(spread, _LEAST_SPREAD))
    return np.where(used, pull, np.nan), np.where(used, weight, 0.0)


def _smoothed(
    normal: Array, slope: Array, penalty: Array | None, before: tuple[Array, float] | None = None
) -> tuple[Array, float]:
    """Solution of the normal equations with the smoothing that it shows itself."""
    if penalty is None:
        return np.asarray(linalg.solve(normal, slope, assume_a="pos")), 0.0
    weakest, strongest = np.array(_SMOOTHING) * float(np.trace(normal) / np.trace(penalty))
    smoothing = max(before[1] if before else 0.0, weakest)
    for _ in range(3 if before else 6):
        inverse = _inverse(normal + smoothing * penalty)
        coefficients = inverse @ slope
        determined = len(slope) - smoothing * float(np.sum(inverse * penalty)) - FREE
        roughness = float(coefficients @ penalty @ coefficients)
        before_it, smoothing = (
            smoothing,
            float(np.clip(max(determined, 1.0) / max(roughness, 1e-300), weakest, strongest)),
        )
        if abs(np.log(smoothing / before_it)) < _ALIKE:
            break
    return np.asarray(coefficients), smoothing


def _inverse(matrix: Array) -> Array:
    size = np.sqrt(np.diag(matrix))
    scaled = matrix / np.outer(size, size)
    return np.asarray(linalg.cho_solve(linalg.cho_factor(scaled), np.eye(len(matrix))) / np.outer(size, size))


def _blur_rad(
    facet: FacetPixels, model: RigModel, basis: Basis, coefficients: Array, showing: Showing, psf_px: float
) -> Array:
    """What a Gaussian blur adds to the phase: the angle of the mean fringe around a pixel, by Gauss-Hermite nodes."""

    def phase_at(offset: tuple[float, float]) -> Array:
        rays = rays_at(model.intrinsics, facet.pixels + psf_px * np.array(offset))
        tangents = basis.rows(rays[:, :2]).tangents(coefficients)
        return reflected_phase(model, rays, tangents, showing.position_mm, along_y=showing.along_y)

    middle = phase_at((0.0, 0.0))
    mean = np.zeros(len(middle), dtype=np.complex128)
    for (across, one), (down, other) in product(_BLUR_NODES, _BLUR_NODES):
        mean += one * other * np.exp(1j * (phase_at((across, down)) - middle))
    return np.asarray(np.angle(mean))
