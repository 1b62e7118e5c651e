"""Facet by facet, the surface that the phases of all stage positions show best: planes, or smooth surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, special

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import EvaluationError, FramesError
from irpmd_rig.core.evaluation.facets import Facets
from irpmd_rig.core.planes import correlation_inflation
from irpmd_rig.core.reconstruction.freeform import Array, Basis, Polynomial, Spline, spline_over
from irpmd_rig.core.reconstruction.surface_fit import (
    FacetPixels,
    Showing,
    SurfaceFit,
    blur_of_range,
    displacement,
    fit_surface,
    start_from_depth,
)
from irpmd_rig.core.reconstruction.surfaces import Surface
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import RigModel

FEWEST_PIXELS = 100
# What departs from a plane by more (rms), and surely, is a curved mirror; a polynomial of this degree shows it.
_FLAT_MM = 5e-3
_SHAPE_DEGREE = 3
_SHAPE_SIGMAS = 3.0
# Pixels that show what another calibration would change: smooth changes, so a few do.
_FEW = 1500
# Both ways to the height are by chance so far apart once in a thousand measurements.
_CHANCE = 1e-3
_SEEN = 0.9


@dataclass(frozen=True, slots=True)
class FacetEstimate:
    """One facet.

    Attributes
    ----------
    facet : int
        Its label.
    kind : str
        "plane" or "smooth".
    surface : Surface
        The surface, with its uncertainties.
    pixels : ndarray of int, (n, 2)
        Column and row, in the camera's picture, of its pixels.
    centre_mm : ndarray, (2,)
        Mean x, y of what they see.
    mean_height_mm : float
        Mean height of what they see.
    height_mm : float
        Height over that point.
    slope : ndarray, (2,)
        dz/dx, dz/dy there.
    chi2_per_dof : float
        Of the phases against the surface with their stated noise: 1 if model and noise are right.
    coherence : float
        How far neighbouring residuals hang together (1: not at all); the covariance is inflated by it.
    piston_difference_mm, piston_sigma_mm : float
        Triangulated height less that of the phases' surface, and its sigma by noise and calibration.
    """

    facet: int
    kind: str
    surface: Surface
    pixels: NDArray[np.int64]
    centre_mm: Array
    mean_height_mm: float
    height_mm: float
    slope: Array
    chi2_per_dof: float
    coherence: float
    piston_difference_mm: float
    piston_sigma_mm: float


@dataclass(frozen=True, slots=True)
class SurfaceEstimate:
    """All facets of an object.

    Attributes
    ----------
    depth_mm, sigma_mm : ndarray of float32, (h, w)
        Height of the facets' surfaces and its standard deviation by noise; NaN outside the facets.
    labels : ndarray of int32, (h, w)
        Facets that were estimated, 0 elsewhere.
    facets : tuple of FacetEstimate
        In the order of their labels.
    chi2_per_dof : float
        Of all phases.
    disagreement : float
        Chi2 per degree of freedom of the facets' triangulated piston and tilt against those of the phases.
    piston : str
        Where the facets' heights and tilts come from: "phases", or "triangulation" where the model is off.
    remarks : tuple of str
        In plain words: facets left out and why, parts that leave the glass, a model that is off.
    """

    depth_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    labels: NDArray[np.int32]
    facets: tuple[FacetEstimate, ...]
    chi2_per_dof: float
    disagreement: float
    piston: str
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Doubts:
    """What is not known exactly apart from the phases' noise.

    Attributes
    ----------
    variations : tuple of RigModel
        The rig displaced along each principal axis of its calibration's covariance by one standard deviation.
    shifts_mm : ndarray, (variations, positions), optional
        By how much each of them would move the views' positions, where these were found with the rig's model.
    sigma_position_mm : float
        Standard deviation of each view's stage position.
    psf_px : float
        RMS width of the camera's blur, corrected where a mirror is curved.
    chi2_limit : float
        Largest chi2 per degree of freedom of the phases for which the model is taken to hold.
    """

    variations: tuple[RigModel, ...] = ()
    shifts_mm: Array | None = None
    sigma_position_mm: float = 0.0
    psf_px: float = 0.0
    chi2_limit: float = 2.0


@dataclass(frozen=True, slots=True)
class _Fitted:
    """A facet before it is decided where its piston comes from."""

    facet: int
    observed: FacetPixels
    basis: Basis
    fit: SurfaceFit
    means: Array  # (3, count): derivatives of the moments of 1 / Z (`FacetPixels.linear`) by the coefficients
    difference: Array  # (3,) of these moments: triangulated less fitted
    covariance: Array  # (3, 3) of the triangulated moments, by noise
    moved: Array  # (s + k, count): coefficients under displaced stage positions and rigs
    moved_difference: Array  # (s + k, 3): the differences under them


def estimate_surfaces(
    views: Views, depth: DepthMap, facets: Facets, model: RigModel, doubts: Doubts | None = None
) -> SurfaceEstimate:
    """Estimate every facet's surface by maximum likelihood.

    Parameters
    ----------
    views : Views
        Phases of the object.
    depth : DepthMap
        Triangulated depth: where the fit begins, and the piston where the model is off.
    facets : Facets
        From `find_facets` on that depth.
    model : RigModel
        The calibrated rig.
    doubts : Doubts, optional
        Uncertainty of the calibration and the like; none by default.

    Returns
    -------
    SurfaceEstimate
        See there.

    Raises
    ------
    FramesError
        If depth or facets are not of the views' shape.
    EvaluationError
        If no facet has enough pixels.

    Notes
    -----
    The phases of a facet tell its height and tilt twice: by their change with the stage's position (triangulation),
    and by how normals and position go together over the facet. The second is more precise and the first to be
    wrong where the model is off (physics notes, section 5). Where both disagree beyond their uncertainty, or the
    phases' chi2 is out of bounds, height and tilt are the triangulated ones and the rest is that of the normals:
    of all facets, for a step between two methods would hold the model's error.
    """
    doubts = doubts or Doubts()
    if not views.shape == depth.depth_mm.shape == facets.labels.shape:
        raise FramesError(
            f"depth map {depth.depth_mm.shape} and facets {facets.labels.shape} must have the shape of the views, "
            f"{views.shape}"
        )
    fitted, remarks = _all_fitted(views, depth, facets, model, doubts)
    if not fitted:
        raise EvaluationError("no facet could be estimated: " + "; ".join(remarks))
    disagreement, bound = _disagreement(fitted)
    chi2 = float(np.average([f.fit.chi2_per_dof for f in fitted], weights=[len(f.observed.pixels) for f in fitted]))
    off = disagreement > bound or chi2 > doubts.chi2_limit
    if off:
        remarks.append(
            f"the calibrated model is off (chi2 per degree of freedom: phases {chi2:.2f}, against triangulation "
            f"{disagreement:.1f}): heights and tilts are the triangulated ones"
        )
    if views.phases_y_rad is None and any(isinstance(f.basis, Spline) for f in fitted):
        remarks.append(
            "curved facets are shown by fringes along x alone: their slopes along y are hardly known, nor are steps "
            "along y; take fringes along x and y, in the calibration of the geometry too"
        )
    estimates = tuple(_estimate(f, model, doubts, disagreement if off else None) for f in fitted)
    maps = _maps(views, fitted, estimates)
    return SurfaceEstimate(*maps, estimates, chi2, disagreement, "triangulation" if off else "phases", tuple(remarks))


def _all_fitted(
    views: Views, depth: DepthMap, facets: Facets, model: RigModel, doubts: Doubts
) -> tuple[list[_Fitted], list[str]]:
    """Every facet that can be fitted, and what there is to say of the others."""
    remarks = [f"a patch of {size} pixels is no facet: too few are left off its edges" for size in facets.too_small]
    fitted: list[_Fitted] = []
    for facet in range(1, facets.count + 1):
        known = facets.mask(facet) & np.isfinite(depth.depth_mm) & (depth.sigma_mm > 0)
        if np.count_nonzero(known) < FEWEST_PIXELS:
            remarks.append(
                f"facet {facet} is left out: {np.count_nonzero(known)} pixels have a depth, {FEWEST_PIXELS} are needed"
            )
            continue
        observed = _observed(views, depth, known, model)
        remarks += _leaves(facet, observed)
        try:
            fitted.append(_fit(facet, observed, model, doubts))
        except np.linalg.LinAlgError:
            remarks.append(f"facet {facet} is left out: its phases do not determine a surface")
    return fitted, remarks


def _observed(views: Views, depth: DepthMap, known: NDArray[np.bool_], model: RigModel) -> FacetPixels:
    rows, columns = np.nonzero(known)
    pixels = np.stack([columns + views.window[1].start, rows + views.window[0].start], axis=1)
    rays = rays_at(model.intrinsics, pixels)
    fall = model.frame.directions(rays)[:, 2]
    inverse = fall / (depth.depth_mm[known].astype(np.float64) - model.frame.camera_mm[2])
    sigma = inverse**2 / np.abs(fall) * depth.sigma_mm[known]
    kinds = [(views.phases_rad, False)] + ([] if views.phases_y_rad is None else [(views.phases_y_rad, True)])
    showings = []
    for maps, along_y in kinds:
        for position, phases, sigmas in zip(views.positions_mm, maps, views.sigmas_rad, strict=True):
            phase, noise = phases[known].astype(np.float64), sigmas[known].astype(np.float64)
            seen = np.isfinite(phase) & (noise > 0)
            weight = np.where(seen, 1 / np.where(seen, noise, 1.0), 0.0)
            showings.append(Showing(position, along_y, np.where(seen, phase, 0.0), weight))
    return FacetPixels(pixels, rays, tuple(showings), inverse, sigma)


def _leaves(facet: int, observed: FacetPixels) -> list[str]:
    remarks = []
    for showing in observed.showings:
        seen = float(np.mean(showing.weight > 0))
        if seen < _SEEN:
            remarks.append(
                f"facet {facet}: at {showing.position_mm:g} mm only {seen:.0%} of its pixels show a phase: the rest of "
                "its reflection leaves the glass or is shaded there"
            )
    return remarks


def _fit(facet: int, observed: FacetPixels, model: RigModel, doubts: Doubts) -> _Fitted:
    low, high = observed.places.min(axis=0), observed.places.max(axis=0)
    centre, scale = (low + high) / 2, float((high - low).max()) / 2
    plane = Polynomial((float(centre[0]), float(centre[1])), scale, 1)
    flat = _is_flat(observed, plane, model)
    basis: Basis = plane if flat else spline_over(observed.places)
    start = start_from_depth(observed, basis)
    fit = fit_surface(observed, model, basis, start, psf_px=0.0 if flat else doubts.psf_px)
    rows = basis.rows(observed.places)
    if not flat and doubts.psf_px > 0:
        blur = blur_of_range(observed, model, basis, fit.coefficients, doubts.psf_px)
        observed = replace(observed, inverse_range=observed.inverse_range - blur)
    rest = observed.inverse_range - rows.inverse_range(fit.coefficients)
    used = np.abs(rest - np.median(rest)) <= 5 * 1.4826 * np.median(np.abs(rest - np.median(rest)))
    linear = observed.linear * used[:, None] / used.sum()
    weighted = linear * observed.inverse_sigma[:, None] * np.sqrt(max(fit.chi2_per_dof, 1.0) * _ripple(observed, rest))
    means = np.stack([rows.slope(rows.value, column) for column in linear.T])
    some = observed.some(_FEW)
    smoothing = fit.smoothing * len(some.pixels) / len(observed.pixels)
    changed = _changed(observed, model, doubts)
    moved, moments = displacement(some, (basis, fit.coefficients, smoothing), model, changed)
    return _Fitted(
        facet, observed, basis, fit, means, linear.T @ rest, weighted.T @ weighted, moved, moments - moved @ means.T
    )


def _ripple(observed: FacetPixels, rest: Array) -> float:
    """How far neighbouring depths hang together beyond a plane's difference: what the patterns leave does."""
    pulls, design = rest / observed.inverse_sigma, observed.linear / observed.inverse_sigma[:, None]
    solution = np.linalg.lstsq(design, pulls, rcond=None)[0]
    columns, rows = observed.pixels.T
    return correlation_inflation(rows, columns, pulls - design @ solution)


def _changed(observed: FacetPixels, model: RigModel, doubts: Doubts) -> list[tuple[RigModel, Array]]:
    """Displaced stage positions, one a position, then displaced rigs."""
    at = np.array([showing.position_mm for showing in observed.showings])
    changed = [(model, np.where(at == position, doubts.sigma_position_mm, 0.0)) for position in np.unique(at)]
    if doubts.shifts_mm is None:
        return changed + [(variation, np.zeros(len(at))) for variation in doubts.variations]
    # Showings along y follow those along x, at the same positions.
    kinds = len(at) // doubts.shifts_mm.shape[1]
    return changed + list(zip(doubts.variations, np.tile(doubts.shifts_mm, kinds), strict=True))


def _is_flat(observed: FacetPixels, plane: Polynomial, model: RigModel) -> bool:
    """Whether what a low polynomial adds to a plane is small or unsure, in depth and in phases."""
    some, basis = observed.some(2 * _FEW), Polynomial(plane.centre, plane.scale, _SHAPE_DEGREE)
    matrix = basis.rows(some.places).matrix()
    orthogonal = np.linalg.qr(matrix[:, : plane.count])[0]
    to_mm = 1 / (some.inverse_range**2).mean() * abs(float(model.frame.directions(some.rays)[:, 2].mean()))
    shape = to_mm * (matrix - orthogonal @ (orthogonal.T @ matrix))

    def rms2(coefficients: Array) -> float:
        return float(np.mean((shape @ coefficients) ** 2))

    # The depth first: neither plane nor low polynomial come near the phases of a strongly curved mirror.
    weighted = matrix / some.inverse_sigma[:, None]
    by_depth, unsure = start_from_depth(some, basis)[0], np.asarray(np.linalg.inv(weighted.T @ weighted))
    bound = _FLAT_MM**2 + _SHAPE_SIGMAS**2 * float(np.einsum("ni,ij,nj->", shape, unsure, shape)) / len(shape)
    if rms2(by_depth) > bound:
        return False
    flat = fit_surface(some, model, plane, start_from_depth(some, plane))
    fit = fit_surface(some, model, basis, (np.pad(flat.coefficients, (0, basis.count - plane.count)), 0.0))
    # By what the shape explains, not by how far it is from none: phases along x alone are explained nearly as well
    # by far-away polynomials that lean along y.
    values = sum(int(np.count_nonzero(showing.weight)) for showing in some.showings)
    before, after = (found.chi2_per_dof * (values - kind.count) for found, kind in ((flat, plane), (fit, basis)))
    explained = (before - after) / (max(fit.chi2_per_dof, 1.0) * fit.coherence)
    if rms2(fit.coefficients) <= _FLAT_MM**2 or explained <= _SHAPE_SIGMAS**2 * (basis.count - plane.count):
        return True
    # A shape in the phases that the depth rules out is an error of the model.
    return rms2(fit.coefficients - by_depth) > bound


def _disagreement(fitted: Sequence[_Fitted]) -> tuple[float, float]:
    """Chi2 per degree of freedom of triangulated against fitted moments, and its bound, rarely exceeded by chance."""
    differences = np.concatenate([f.difference for f in fitted])
    together = np.concatenate([f.moved_difference for f in fitted], axis=1)
    covariance = linalg.block_diag(*(f.covariance for f in fitted)) + together.T @ together
    size = np.sqrt(np.diag(covariance))
    pulls = differences / size
    chi2 = float(pulls @ np.linalg.solve(covariance / np.outer(size, size), pulls))
    return chi2 / len(pulls), float(special.chdtri(len(pulls), _CHANCE)) / len(pulls)


def _estimate(fitted: _Fitted, model: RigModel, doubts: Doubts, off: float | None) -> FacetEstimate:
    """The facet; where the model is ``off``, by so much, with the triangulated height and tilt."""
    coefficients, covariance, moved = fitted.fit.coefficients, fitted.fit.covariance, fitted.moved
    if off is not None:
        # The most likely surface among those whose piston and tilt are the triangulated ones. On a curved mirror slopes
        # and blur put those off as well, so that how far both ways differ is the measure of either.
        unsure = fitted.covariance * (max(off, 1.0) if isinstance(fitted.basis, Spline) else 1.0)
        crossed = covariance @ fitted.means.T
        gain = np.linalg.solve(fitted.means @ crossed, crossed.T).T
        coefficients = coefficients + gain @ fitted.difference
        covariance = covariance - gain @ crossed.T + gain @ unsure @ gain.T
        moved = moved + fitted.moved_difference @ gain.T
    stages = len(moved) - len(doubts.variations)
    displaced = tuple(zip(doubts.variations, moved[stages:], strict=True))
    surface = Surface(model, fitted.basis, coefficients, covariance, moved[:stages], displaced)
    points = surface.points_mm(fitted.observed.pixels)
    centre = points[:, :2].mean(axis=0)
    rays = fitted.observed.rays
    to_mm = float(
        np.mean(((points[:, 2] - model.frame.camera_mm[2]) ** 2) / np.abs(model.frame.directions(rays)[:, 2]))
    )
    sigma = np.sqrt(fitted.covariance[0, 0] + float(np.sum(fitted.moved_difference[:, 0] ** 2)))
    return FacetEstimate(
        facet=fitted.facet,
        kind="plane" if isinstance(fitted.basis, Polynomial) else "smooth",
        surface=surface,
        pixels=fitted.observed.pixels,
        centre_mm=centre,
        mean_height_mm=float(points[:, 2].mean()),
        height_mm=surface.height_mm(centre),
        slope=surface.slope(centre),
        chi2_per_dof=fitted.fit.chi2_per_dof,
        coherence=fitted.fit.coherence,
        piston_difference_mm=to_mm * float(fitted.difference[0]),
        piston_sigma_mm=to_mm * float(sigma),
    )


def _maps(
    views: Views, fitted: Sequence[_Fitted], estimates: Sequence[FacetEstimate]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    depth, sigma = (np.full(views.shape, np.nan, dtype=np.float32) for _ in range(2))
    labels = np.zeros(views.shape, dtype=np.int32)
    for facet, estimate in zip(fitted, estimates, strict=True):
        surface, frame = estimate.surface, estimate.surface.model.frame
        columns, rows = (facet.observed.pixels - (views.window[1].start, views.window[0].start)).T
        design = facet.basis.rows(facet.observed.places)
        inverse = design.inverse_range(surface.coefficients)
        fall = frame.directions(facet.observed.rays)[:, 2]
        depth[rows, columns] = frame.camera_mm[2] + fall / inverse
        sigma[rows, columns] = np.abs(fall) / inverse**2 * np.sqrt(design.variance(surface.covariance))
        labels[rows, columns] = facet.facet
    return depth, sigma, labels
