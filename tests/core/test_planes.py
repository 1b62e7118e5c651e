"""Planes seen from one point: unbiased, with an honest covariance."""

import numpy as np
import pytest
from scipy import ndimage

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.planes import fit_plane

TRUE_Q = np.array([-0.3, 0.1, 0.95]) / 320.0


def view(size=120):
    x, y = np.meshgrid(np.linspace(-0.05, 0.09, size), np.linspace(-0.07, 0.07, size))
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def test_exact_without_noise():
    directions = view()
    plane = fit_plane(directions, 1 / (directions @ TRUE_Q), np.ones((120, 120), bool))
    np.testing.assert_allclose(plane.q, TRUE_Q, rtol=1e-12)
    assert plane.distance_mm == pytest.approx(320.0 / np.sqrt(0.3**2 + 0.1**2 + 0.95**2))
    assert plane.normal @ (directions[0, 0] / (directions[0, 0] @ TRUE_Q)) == pytest.approx(-plane.distance_mm)
    np.testing.assert_allclose(plane.depth_mm(directions), 1 / (directions @ TRUE_Q))


def test_stated_covariance_holds_and_the_fit_is_unbiased():
    directions, mask = view(), np.ones((120, 120), bool)
    depth = 1 / (directions @ TRUE_Q)
    rng = np.random.default_rng(1)
    fits = [fit_plane(directions, depth + rng.normal(0, 0.2, depth.shape), mask) for _ in range(60)]
    errors = np.array([fit.q - TRUE_Q for fit in fits])
    covariance = np.mean([fit.covariance for fit in fits], axis=0)
    chi2 = np.einsum("ki,ij,kj->k", errors, np.linalg.inv(covariance), errors) / 3
    assert 0.75 < chi2.mean() < 1.3
    z = np.sqrt(np.diag(covariance) / len(fits))
    assert (np.abs(errors.mean(axis=0)) < 4 * z).all()


def test_correlated_residuals_widen_the_covariance():
    directions, mask = view(480), np.ones((480, 480), bool)
    depth = 1 / (directions @ TRUE_Q)
    rng = np.random.default_rng(2)
    white = rng.normal(0, 0.1, depth.shape)
    blocky = np.kron(rng.normal(0, 0.1, (40, 40)), np.ones((12, 12)))
    narrow = fit_plane(directions, depth + white, mask).covariance[2, 2]
    wide = fit_plane(directions, depth + blocky, mask).covariance[2, 2]
    assert wide > 50 * narrow


def test_the_covariance_holds_for_noise_that_the_optics_correlate():
    directions, mask = view(160), np.ones((160, 160), bool)
    depth = 1 / (directions @ TRUE_Q)
    pulls = []
    for seed in range(30):
        white = np.random.default_rng(seed).normal(0, 1.0, depth.shape)
        fit = fit_plane(directions, depth + ndimage.gaussian_filter(white, 1.5), mask)
        error = fit.q - TRUE_Q
        pulls.append(error @ np.linalg.inv(fit.covariance) @ error / 3)
    assert 0.5 < np.mean(pulls) < 2.0


def test_outliers_of_either_sign_do_not_pull_the_plane():
    directions, mask = view(), np.ones((120, 120), bool)
    rng = np.random.default_rng(3)
    depth = 1 / (directions @ TRUE_Q) + rng.normal(0, 0.05, mask.shape)
    depth[rng.random(mask.shape) < 0.03] += 9.0
    plane = fit_plane(directions, depth, mask)
    middle = np.array([0.02, 0.0, 1.0])
    assert 1 / (middle @ plane.q) == pytest.approx(1 / (middle @ TRUE_Q), abs=0.01)


def test_too_few_pixels_or_a_line_of_them_are_refused():
    directions = view()
    depth = 1 / (directions @ TRUE_Q)
    few = np.zeros(depth.shape, bool)
    few[:5, :5] = True
    with pytest.raises(CalibrationError, match="at least 50"):
        fit_plane(directions, depth, few)
    line = np.zeros(depth.shape, bool)
    line[60] = True
    with pytest.raises(CalibrationError, match="on a line"):
        fit_plane(directions, depth, line)
