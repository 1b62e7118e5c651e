"""Curved mirrors: surfaces over the camera's rays, shape from normals, piston from position, and what blur does."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from irpmd_rig.core import find_facets
from irpmd_rig.core.reconstruction.facet_estimate import Doubts, estimate_surfaces
from irpmd_rig.core.reconstruction.freeform import Polynomial, spline_over
from irpmd_rig.core.reconstruction.triangulation import triangulate
from tests.core.seen_objects import DEPTH_SIGMA_MM, SIGMA_RAD, seen

PLACES = np.random.default_rng(0).uniform((-0.2, -0.1), (0.1, 0.2), (3000, 2))


@pytest.mark.parametrize("basis", [Polynomial((-0.05, 0.05), 0.15, 3), spline_over(PLACES)])
def test_derivatives_are_those_of_the_values(basis):
    coefficients = np.random.default_rng(1).standard_normal(basis.count)
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = 1e-6
        ahead, behind = (basis.rows(PLACES + sign * step).inverse_range(coefficients) for sign in (1, -1))
        rows = basis.rows(PLACES)
        derivative = ((rows.by_x, rows.by_y)[axis] * coefficients[rows.columns]).sum(axis=1)
        np.testing.assert_allclose(derivative, (ahead - behind) / 2e-6, atol=1e-5)


def test_a_spline_holds_cubics_without_roughness_and_continues_them():
    basis = spline_over(PLACES)

    def cubic(places):
        x, y = places.T * 5
        return 1 + 0.3 * x - y + x * y + 0.5 * x**3 - 0.2 * x * y**2

    rows = basis.rows(PLACES)
    coefficients = np.linalg.lstsq(rows.matrix(), cubic(PLACES), rcond=1e-12)[0]
    assert coefficients @ basis.roughness() @ coefficients < 1e-12
    beyond = np.array([[0.14, 0.1], [-0.22, -0.12], [0.0, 0.25]])
    assert basis.holds(beyond).all()
    assert not basis.holds(np.array([[0.4, 0.0]])).any()
    np.testing.assert_allclose(basis.rows(beyond).inverse_range(coefficients), cubic(beyond), atol=1e-6)


def test_sums_over_cells_are_those_of_whole_matrices():
    rows = spline_over(PLACES).rows(PLACES)
    whole = rows.matrix()
    values = np.random.default_rng(2).standard_normal(len(PLACES))
    np.testing.assert_allclose(rows.normal(rows.value), whole.T @ whole, atol=1e-10)
    np.testing.assert_allclose(rows.slope(rows.value, values), whole.T @ values, atol=1e-10)
    covariance = np.diag(np.random.default_rng(3).uniform(1, 2, rows.count))
    np.testing.assert_allclose(rows.variance(covariance), np.diag(whole @ covariance @ whole.T), atol=1e-10)


@pytest.fixture(scope="module")
def mirrors():
    return seen("freeform", with_y=True)


def errors_mm(shown, estimate):
    """Per facet: error of the mean height, and rms of the rest."""
    error = estimate.depth_mm - shown.depth_mm
    facets = [error[estimate.labels == facet.facet] for facet in estimate.facets]
    return np.array([f.mean() for f in facets]), np.array([f.std() for f in facets])


def test_surfaces_are_exact_without_noise(mirrors):
    depth = mirrors.depth_with(0.0, 0)
    estimate = estimate_surfaces(mirrors.views_with(0.0, 0), depth, find_facets(depth.depth_mm), mirrors.model)
    assert [facet.kind for facet in estimate.facets] == ["smooth", "smooth"]
    piston, rest = errors_mm(mirrors, estimate)
    assert np.abs(piston).max() < 5e-5
    assert rest.max() < 5e-5


def test_shape_comes_from_normals_and_is_far_surer_than_piston(mirrors):
    pulls, rests = [], []
    for seed in range(2):
        depth = mirrors.depth_with(DEPTH_SIGMA_MM, seed)
        estimate = estimate_surfaces(
            mirrors.views_with(SIGMA_RAD, seed), depth, find_facets(depth.depth_mm), mirrors.model
        )
        piston, rest = errors_mm(mirrors, estimate)
        sigma = [float(np.nanmean(estimate.sigma_mm[estimate.labels == facet.facet])) for facet in estimate.facets]
        pulls += list(piston / sigma)
        rests += list(rest)
        assert estimate.chi2_per_dof == pytest.approx(1.0, abs=0.15)
    # At 384 px; at full size there are 28 times as many pixels.
    assert np.median(rests) < 0.3e-3
    assert 0.05 < np.mean(np.square(pulls)) < 3


def test_x_fringes_alone_leave_the_shape_across_them_to_position(mirrors):
    alone = replace(mirrors.views_with(SIGMA_RAD, 1), phases_y_rad=None)
    depth = mirrors.depth_with(DEPTH_SIGMA_MM, 1)
    estimate = estimate_surfaces(alone, depth, find_facets(depth.depth_mm), mirrors.model)
    error = (estimate.depth_mm - mirrors.depth_mm) / estimate.sigma_mm
    assert 0.3 < np.nanmean(error**2) < 2.5
    assert np.nanmax(estimate.sigma_mm) < 0.05


def blurred(phase, sigma_px):
    """What a camera with that blur decodes: the angle of the blurred fringes."""
    known = np.isfinite(phase)
    wave = np.where(known, np.exp(1j * np.nan_to_num(phase)), 0)
    soft = ndimage.gaussian_filter(wave.real, sigma_px) + 1j * ndimage.gaussian_filter(wave.imag, sigma_px)
    turned = np.angle(soft * np.exp(-1j * np.nan_to_num(phase)))
    return np.where(known, phase + turned, np.nan)


def blurred_views(shown, psf_px):
    views = shown.views_with(0.0, 0)
    along_x, along_y = (
        tuple(blurred(phase, psf_px) for phase in phases) for phases in (views.phases_rad, views.phases_y_rad)
    )
    return replace(views, phases_rad=along_x, phases_y_rad=along_y)


def test_the_bias_of_blur_on_curved_mirrors_is_taken_out(mirrors):
    psf_px = 0.7
    views = blurred_views(mirrors, psf_px)
    depth = mirrors.depth_with(0.0, 0)
    facets = find_facets(depth.depth_mm)
    plain, corrected = (
        errors_mm(mirrors, estimate_surfaces(views, depth, facets, mirrors.model, doubts))[0]
        for doubts in (Doubts(chi2_limit=np.inf), Doubts(chi2_limit=np.inf, psf_px=psf_px))
    )
    assert np.abs(corrected).max() < 0.2 * np.abs(plain).max()


def test_the_bias_of_blur_is_taken_out_of_the_triangulated_piston_too():
    shown, psf_px = seen("freeform", size_px=1024, with_y=True), 0.7
    views = blurred_views(shown, psf_px)
    depth = triangulate(views, shown.model)
    facets = find_facets(depth.depth_mm)
    # A limit that nothing keeps: the model is taken to be off.
    plain, corrected = (
        estimate_surfaces(views, depth, facets, shown.model, doubts)
        for doubts in (Doubts(chi2_limit=0.0), Doubts(chi2_limit=0.0, psf_px=psf_px))
    )
    assert plain.piston == corrected.piston == "triangulation"
    before, after = (np.abs(errors_mm(shown, estimate)[0]).max() for estimate in (plain, corrected))
    assert before > 5e-3
    assert after < 0.5 * before
