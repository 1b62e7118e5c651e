"""Filters that stay inside a facet."""

import numpy as np
import pytest

from irpmd_rig.core.reconstruction.local_fit import local_fit
from irpmd_rig.core.reconstruction.phase_filter import filter_phase
from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.views import Views
from tests.core.reconstruction.traced_views import SIGMA_RAD, seen, world_of

SIZE_PX = 256


@pytest.fixture(scope="module")
def steps():
    return seen(world_of("misaligned"), "mirror_step_y", (0.0, 40.0), SIZE_PX, sigma_rad=SIGMA_RAD)


def test_a_region_belongs_to_one_facet_and_every_facet_has_one(steps):
    regions = smooth_regions(steps.views)
    found = [set(steps.facet[regions == region]) for region in range(1, regions.max() + 1)]
    assert sorted(found, key=min) == [{0}, {1}, {2}, {3}, {4}]
    assert np.count_nonzero(regions) > 0.75 * np.isfinite(steps.depth_mm).sum()


def test_an_edge_without_a_step_parts_regions_too():
    tilted = seen(world_of("ideal"), "mirror_step_tilted", (0.0, 40.0), SIZE_PX)
    freeform = seen(world_of("ideal"), "freeform", (0.0, 40.0), SIZE_PX, sigma_rad=SIGMA_RAD)
    assert smooth_regions(tilted.views).max() == 5
    assert smooth_regions(freeform.views).max() == 2
    column = np.arange(40.0)
    roof = np.tile(np.where(column < 20, 0.3 * column, 6.0 + 0.1 * (column - 20)), (40, 1))
    sigma = np.full((40, 40), 0.005)
    views = Views((0.0, 40.0), (roof, roof), (sigma, sigma), np.s_[0:40, 0:40])
    assert smooth_regions(views).max() == 2


def test_the_filter_takes_away_noise_as_it_says_and_crosses_no_edge(steps):
    exact = seen(world_of("misaligned"), "mirror_step_y", (0.0, 40.0), SIZE_PX)
    filtered = filter_phase(steps.views)
    inside = smooth_regions(steps.views) > 0
    for phase, sigma, truth in zip(filtered.phases_rad, filtered.sigmas_rad, exact.views.phases_rad, strict=True):
        pulls = (phase - truth)[inside] / sigma[inside]
        assert pulls.std() == pytest.approx(1.0, abs=0.05)
        assert np.abs(pulls).max() < 6
        assert np.median(sigma[inside]) < 0.35 * SIGMA_RAD
    outside = ~inside & np.isfinite(steps.depth_mm)
    for phase, raw in zip(filtered.phases_rad, steps.views.phases_rad, strict=True):
        np.testing.assert_array_equal(phase[outside], raw[outside])


def test_a_local_fit_meets_a_quadratic_surface_to_the_edge():
    v, u = np.mgrid[0:20.0, 0:30.0]
    values = 3 + 0.2 * u - 0.1 * v + 0.01 * u**2 - 0.02 * u * v + 0.005 * v**2
    regions = np.ones(values.shape, np.int32)
    regions[:, 15:] = 2
    values[regions == 2] += 100.0
    regions[5:8, 5:8] = 0
    fit = local_fit(u, v, values, regions, 4)
    known = regions > 0
    assert np.isnan(fit.value[~known]).all()
    np.testing.assert_allclose(fit.value[known], values[known], atol=1e-9)
    np.testing.assert_allclose(fit.gx[known], (0.2 + 0.02 * u - 0.02 * v)[known], atol=1e-9)
    np.testing.assert_allclose(fit.gy[known], (-0.1 - 0.02 * u + 0.01 * v)[known], atol=1e-9)
    for found, true in ((fit.hxx, 0.02), (fit.hxy, -0.02), (fit.hyy, 0.01)):
        np.testing.assert_allclose(found[known], true, atol=1e-9)
    assert fit.gain[10, 7] < fit.gain[0, 0] < 1


def test_a_region_too_narrow_for_a_surface_has_none():
    v, u = np.mgrid[0:20.0, 0:20.0]
    regions = np.zeros((20, 20), np.int32)
    regions[:, 10:12] = 1
    assert np.isnan(local_fit(u, v, u, regions, 3).value).all()
    assert np.isnan(local_fit(u, v, u, np.zeros_like(regions), 3).value).all()
