"""Local quadratic fits: exact on quadratic surfaces, apart from region to region, and only where they are asked for."""

import numpy as np
import pytest

from irpmd_rig.core.reconstruction.local_fit import local_fit

Y, X = np.meshgrid(np.arange(24) * 0.7, np.arange(150) * 0.8, indexing="ij")
X, Y = X + 0.05 * Y, Y - 0.02 * X


def surface(a):
    return 1.0 + a * X - 0.2 * Y + 0.03 * X**2 + 0.01 * X * Y - 0.02 * Y**2


def test_a_quadratic_surface_and_its_derivatives_are_met_up_to_the_edge():
    fit = local_fit(X, Y, surface(0.5), np.ones(X.shape, np.int32), 4)
    np.testing.assert_allclose(fit.value, surface(0.5), rtol=1e-10)
    np.testing.assert_allclose(fit.gx, 0.5 + 0.06 * X + 0.01 * Y, rtol=1e-8)
    np.testing.assert_allclose(fit.gy, -0.2 + 0.01 * X - 0.04 * Y, rtol=1e-8)
    for found, true in ((fit.hxx, 0.06), (fit.hxy, 0.01), (fit.hyy, -0.04)):
        np.testing.assert_allclose(found, true, atol=1e-8)


def test_another_region_and_what_is_unknown_do_not_count():
    regions = np.where(np.arange(150) < 70, 1, 2) * np.ones(X.shape, np.int32)
    values = np.where(regions == 1, surface(0.5), surface(-3.0))
    values[5, 60:64] = np.nan
    regions[9, 9] = 0
    fit = local_fit(X, Y, values, regions, 4)
    known = np.isfinite(values) & (regions > 0)
    np.testing.assert_allclose(fit.value[known], values[known], rtol=1e-9)
    assert np.isnan(fit.value[~known]).all()


def test_only_the_rows_asked_for_are_fitted_and_just_as_well():
    regions = np.ones(X.shape, np.int32)
    noisy = surface(0.5) + np.random.default_rng(0).normal(0, 0.1, X.shape)
    whole, some = local_fit(X, Y, noisy, regions, 4), local_fit(X, Y, noisy, regions, 4, rows=slice(1, None, 3))
    np.testing.assert_array_equal(some.gy[1::3], whole.gy[1::3])
    assert np.isnan(some.gy[::3]).all()
    assert np.isnan(some.gy[2::3]).all()


def test_the_gain_is_the_variance_that_the_fit_leaves():
    regions, rng = np.ones(X.shape, np.int32), np.random.default_rng(1)
    fits = [local_fit(X, Y, rng.normal(size=X.shape), regions, 4) for _ in range(30)]
    scatter = np.var([fit.value for fit in fits], axis=0)
    assert np.mean(scatter / fits[0].gain) == pytest.approx(1.0, abs=0.05)
