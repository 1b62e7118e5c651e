"""Planes without bias, steps in one definition, uncertainties that hold."""

import numpy as np
import pytest

from irpmd_rig.core import find_facets, fit_facets, step_heights
from irpmd_rig.core.errors import EvaluationError, FramesError

from .scene import FRAME, RAYS, TABLE_2, on_plane, stepped_depth


def measured(depth):
    facets = find_facets(depth)
    planes = fit_facets(depth, facets, FRAME, RAYS)
    return facets, planes


@pytest.mark.parametrize("along", ["x", "y"])
def test_steps_are_exact_without_noise(along):
    _facets, planes = measured(stepped_depth(along=along)[0])
    steps = step_heights(planes)
    assert [step.name for step in steps] == ["1-2", "2-3", "3-4", "4-5"]
    np.testing.assert_allclose([s.height_mm for s in steps], TABLE_2, atol=1e-9)
    np.testing.assert_allclose([s.mean_height_difference_mm for s in steps], TABLE_2, atol=1e-9)
    assert max(s.combined_um for s in steps) < 1e-3


def test_tilted_treads_have_their_slope_and_the_step_of_their_planes():
    slopes = (0.0105, -0.006)
    _facets, planes = measured(stepped_depth(slopes=slopes)[0])
    for plane in planes:
        np.testing.assert_allclose(plane.slope, slopes, atol=1e-9)
    np.testing.assert_allclose([s.height_mm for s in step_heights(planes)], TABLE_2, atol=1e-8)


def naive_plane_height(depth, mask, directions, camera):
    """Least squares of z over the x, y that come from the same noisy z: what not to do."""
    reach = (depth - camera[2]) / directions[..., 2]
    points = (camera + reach[..., None] * directions)[mask]
    design = np.column_stack([points[:, :2] - points[:, :2].mean(axis=0), np.ones(len(points))])
    return np.linalg.lstsq(design, points[:, 2], rcond=None)[0]


def test_the_fit_is_unbiased_where_a_plain_one_is_not():
    noise_mm = 0.3
    slopes, plain = [], []
    for seed in range(12):
        depth, _truth = stepped_depth(along="x", noise_mm=noise_mm, seed=seed)
        facets, planes = measured(depth)
        slopes += [plane.slope[0] for plane in planes]
        plain += [
            naive_plane_height(depth, facets.mask(f), FRAME.directions(RAYS), FRAME.camera_mm)[0]
            for f in range(1, facets.count + 1)
        ]
    assert abs(np.mean(plain)) > 4 * np.std(plain) / np.sqrt(len(plain))
    assert abs(np.mean(slopes)) < 4 * np.std(slopes) / np.sqrt(len(slopes))


@pytest.mark.parametrize("noise_mm", [0.075, 0.3])
def test_the_stated_random_uncertainty_holds(noise_mm):
    pulls = []
    for seed in range(40):
        _facets, planes = measured(stepped_depth(noise_mm=noise_mm, seed=100 + seed)[0])
        steps = step_heights(planes)
        pulls += [1e3 * (s.height_mm - t) / s.random_um for s, t in zip(steps, TABLE_2, strict=True)]
    assert 0.7 < np.mean(np.square(pulls)) < 1.35


def test_a_curved_facet_is_not_called_a_plane():
    x, y, _ = on_plane(0.0, (0.0, 0.0))
    depth, _ = stepped_depth((4.0,), noise_mm=0.02)
    depth = depth + np.where(y > 0, (x - 36) ** 2 / 2000, 0.0)
    _facets, planes = measured(depth)
    assert [plane.flat for plane in planes].count(False) == 1
    with pytest.raises(EvaluationError, match="curved"):
        step_heights(planes)


def test_maps_of_different_size_are_refused():
    depth, _ = stepped_depth(noise_mm=0.02)
    with pytest.raises(FramesError, match="of one size"):
        fit_facets(depth[:-1], find_facets(depth), FRAME, RAYS)


def test_one_facet_has_no_step():
    depth, truth = stepped_depth(noise_mm=0.02)
    depth[truth != 2] = np.nan
    _facets, planes = measured(depth)
    with pytest.raises(EvaluationError, match="two facets, and 1"):
        step_heights(planes)
