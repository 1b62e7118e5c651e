"""Facets are found from the depth map alone."""

import numpy as np
import pytest
from scipy import ndimage

from irpmd_rig.core import find_facets
from irpmd_rig.core.errors import EvaluationError, FramesError, MeasurementError

from .scene import RAYS, on_plane, stepped_depth


def agrees(facets, truth):
    """Every facet found lies in one true facet, keeps its edges away, and covers most of it."""
    for label in range(1, facets.count + 1):
        mask = facets.mask(label)
        inside = np.unique(truth[mask])
        assert inside.tolist() == [label - 1]
        assert mask.sum() > 0.55 * (truth == label - 1).sum()
        edge = ndimage.binary_dilation(truth != label - 1, iterations=2)
        assert not (mask & edge).any()


@pytest.mark.parametrize("noise_um", [0, 75, 300])
@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.03, -0.02)])
def test_the_treads_of_table_2_are_found_for_any_noise_and_tilt(noise_um, along, slopes):
    depth, truth = stepped_depth(along=along, slopes=slopes, noise_mm=noise_um / 1e3)
    facets = find_facets(depth)
    assert facets.count == 5
    agrees(facets, truth)
    assert facets.noise_mm == pytest.approx(noise_um / 1e3, rel=0.1, abs=2e-4)


@pytest.mark.parametrize("steps_mm", [(0.9,), (2.0, 3.0), (6.5, 5.5, 5.0, 4.0, 3.0), (-3.0, -4.0)])
def test_any_number_of_steps_numbered_upwards(steps_mm):
    depth, _truth = stepped_depth(steps_mm, noise_mm=0.1)
    facets = find_facets(depth)
    assert facets.count == len(steps_mm) + 1
    means = [depth[facets.mask(label)].mean() for label in range(1, facets.count + 1)]
    assert np.allclose(np.diff(means), np.abs(steps_mm) if steps_mm[0] > 0 else np.abs(steps_mm)[::-1], atol=0.02)


def test_edges_that_mix_both_sides_specks_and_outliers_do_no_harm():
    depth, truth = stepped_depth(noise_mm=0.09, seed=4)
    blurred = ndimage.gaussian_filter(np.nan_to_num(depth), 1.0)
    rim = ndimage.binary_dilation(ndimage.morphological_gradient(truth, size=3) > 0, iterations=1) & (truth >= 0)
    depth[rim] = blurred[rim]
    rng = np.random.default_rng(5)
    specks = rng.random(depth.shape)
    depth[specks < 0.02] = np.nan
    outliers = (specks > 0.98) & np.isfinite(depth)
    depth[outliers] += rng.choice([-5.0, 5.0, 40.0], outliers.sum())
    facets = find_facets(depth)
    assert facets.count == 5
    assert not (facets.labels[outliers] > 0).any()
    for label in range(1, 6):
        assert np.unique(truth[facets.mask(label)]).tolist() == [label - 1]


def test_a_scratch_does_not_part_a_facet_a_gap_does():
    depth, _truth = stepped_depth((5.0,), along="y", noise_mm=0.05)
    depth[:, 150:154] = np.nan
    assert find_facets(depth).count == 2
    depth[:, 150:170] = np.nan
    assert find_facets(depth).count == 4


@pytest.mark.parametrize("noise_um", [80.0, 30.0, 10.0])
def test_sloping_treads_stand_beside_level_ones(noise_um):
    y = 0.06 * np.arange(300)[:, None]
    depth = np.concatenate(
        [
            height + slope * (y - 9.0) * np.ones(100)
            for height, slope in ((0, 0), (4, 0.1), (9, 0), (14, 0.1), (20, -0.1))
        ],
        axis=1,
    )
    depth += np.random.default_rng(7).normal(0, noise_um * 1e-3, depth.shape)
    assert find_facets(depth).count == 5


def test_curved_mirrors_are_facets_too():
    x, y, _ = on_plane(0.0, (0.0, 0.0))
    sphere = ((x - 18) ** 2 + y**2) / 200
    saddle = ((x - 56) ** 2 - y**2) / 220 + 1.0
    depth = np.where((np.abs(x - 18) < 15) & (np.abs(y) < 15), sphere, np.nan)
    depth = np.where((np.abs(x - 56) < 15) & (np.abs(y) < 15), saddle, depth)
    depth += np.random.default_rng(0).normal(0, 0.08, depth.shape)
    assert find_facets(depth).count == 2


def test_patches_that_erosion_leaves_too_few_pixels_of_are_counted():
    depth, truth = stepped_depth((5.0,), along="y", noise_mm=0.05)
    rows = np.nonzero((truth == 1).any(axis=1))[0]
    strip = np.zeros(depth.shape, bool)
    strip[rows[:12]] = True
    facets = find_facets(depth, (truth == 0) | (strip & (truth == 1)), erosion_px=5)
    assert facets.count == 1
    assert len(facets.too_small) == 1
    assert facets.too_small[0] > 500


def test_the_mask_is_obeyed():
    depth, truth = stepped_depth(noise_mm=0.05)
    facets = find_facets(depth, truth >= 3)
    assert facets.count == 2
    np.testing.assert_array_equal(find_facets(depth, (truth >= 3).astype(int)).labels, facets.labels)
    assert not (facets.labels[truth < 3] > 0).any()


def test_what_cannot_be_found_is_said():
    with pytest.raises(EvaluationError, match="0 pixels"):
        find_facets(np.full(RAYS.shape[:2], np.nan))
    depth, _ = stepped_depth()
    with pytest.raises(EvaluationError, match="at least 1000000 pixels"):
        find_facets(depth, min_pixels=1_000_000)
    for odd in (np.ones((3, 3), bool), np.ones(depth.shape)):
        with pytest.raises(FramesError, match="mask alike"):
            find_facets(depth, odd)
    for odd in (None, "map", depth.astype(complex), depth[0]):
        with pytest.raises(FramesError):
            find_facets(odd)
    with pytest.raises(MeasurementError, match="erosion_px"):
        find_facets(depth, erosion_px=-1)
