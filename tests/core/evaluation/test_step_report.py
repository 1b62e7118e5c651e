"""Steps of estimated surfaces: one definition, for curved facets across their gap too."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core import Facets, find_facets, fit_facets, rays
from irpmd_rig.core.errors import EvaluationError
from irpmd_rig.core.evaluation.step_report import SURFACE_STEP, steps_of
from irpmd_rig.core.reconstruction.facet_estimate import estimate_surfaces
from sims.surfaces import object_patches
from sims.truth import true_steps_mm
from tests.core.seen_objects import DEPTH_SIGMA_MM, SIGMA_RAD, misaligned, seen


@pytest.fixture(scope="module")
def mirrors():
    return seen("freeform", with_y=True)


def estimated(shown, sigma_rad=0.0, sigma_mm=0.0, seed=0):
    depth = shown.depth_with(sigma_mm, seed)
    return estimate_surfaces(shown.views_with(sigma_rad, seed), depth, find_facets(depth.depth_mm), shown.model)


def true_height_mm(patch, xy_mm):
    """The mirror's biconic with its bump, continued beyond its outline; found by bisection along z."""

    def above(z):
        x, y, height = patch.axes @ (np.array([*xy_mm, z]) - patch.origin)
        bend = np.array(patch.curvature)
        root = np.sqrt(1 - (bend[0] * x) ** 2 - (bend[1] * y) ** 2)
        tall, wide, bx, by = patch.bump
        bump = tall * np.exp(-((x - bx) ** 2 + (y - by) ** 2) / (2 * wide**2))
        return height - (bend[0] * x**2 + bend[1] * y**2) / (1 + root) - bump

    low, high = -20.0, 20.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if above(middle) > 0 else (middle, high)
    return low


def test_a_step_across_a_gap_is_taken_in_its_middle_between_the_continued_surfaces(mirrors):
    steps = steps_of(estimated(mirrors))
    lower, upper = object_patches(mirrors.world, "freeform")
    (place,) = steps.at_mm
    # The two outlines, 30 mm wide and tilted by 3 deg, leave a gap of 8 mm about y = 0.
    assert abs(place[0] - 36) < 1
    assert abs(place[1]) < 0.7
    truth = true_height_mm(upper, place) - true_height_mm(lower, place)
    assert steps.values_mm[0] == pytest.approx(truth, abs=1.5e-3)
    assert steps.definition == SURFACE_STEP


def test_the_difference_of_means_is_that_of_the_same_pixels_of_the_truth(mirrors):
    for seed in range(2):
        estimate = estimated(mirrors, SIGMA_RAD, DEPTH_SIGMA_MM, seed)
        steps = steps_of(estimate)
        true_means = [mirrors.depth_mm[estimate.labels == facet].mean() for facet in (1, 2)]
        # Continuing a surface adds doubt of its own.
        assert abs(steps.means_mm[0] - np.diff(true_means)[0]) < 2 * steps.sigma_mm[0]


def test_steps_of_tilted_planes_are_those_of_the_planes_halfway_between_the_centres():
    tilts = ((0.3, -0.2), (-0.4, 0.1), (0.0, 0.5), (0.2, 0.2), (-0.1, -0.3))
    world = misaligned()
    tilted = world.objects["mirror_step_y"].model_copy(update={"tilts_deg": tilts})
    world = world.model_copy(update={"objects": {**world.objects, "mirror_step_y": tilted}})
    shown = seen("mirror_step_y", world=type(world).model_validate(world.model_dump()))
    estimate = estimated(shown)
    steps = steps_of(estimate)
    centres = np.array([facet.centre_mm for facet in estimate.facets])
    np.testing.assert_allclose(steps.at_mm, (centres[1:] + centres[:-1]) / 2)
    # The simulation takes halfway between the outlines' centroids, from which the pixels' are a little off.
    np.testing.assert_allclose(steps.values_mm, true_steps_mm(shown.world, "mirror_step_y"), atol=0.04)
    assert np.abs(steps.values_mm - steps.means_mm).max() > 0.02


def test_a_step_needs_two_facets(mirrors):
    depth = mirrors.depth_with(0.0, 0)
    found = find_facets(depth.depth_mm)
    one = Facets(np.where(found.labels == 1, 1, 0).astype(np.int32), 1, 0.08)
    with pytest.raises(EvaluationError, match="two facets, and 1"):
        steps_of(estimate_surfaces(mirrors.views_with(0.0, 0), depth, one, mirrors.model))


@pytest.mark.parametrize(("apart_mm", "said"), [(0.0, "have the same centre"), (1e-6, "facet 1 has no pixel near")])
def test_curved_facets_without_a_gap_between_them_have_no_step(mirrors, apart_mm, said):
    estimate = estimated(mirrors)
    lower, upper = estimate.facets
    around = replace(upper, centre_mm=np.add(lower.centre_mm, (apart_mm, 0.0)))
    with pytest.raises(EvaluationError, match=said):
        steps_of(replace(estimate, facets=(lower, around)))


@pytest.mark.parametrize("noise_mm", [0.0, 0.09, 0.25])
def test_freeform_mirrors_are_found_and_not_called_planes(mirrors, noise_mm):
    depth_mm = mirrors.depth_with(noise_mm, 3).depth_mm
    facets = find_facets(depth_mm)
    assert [np.unique(mirrors.facet[facets.mask(facet)]).tolist() for facet in (1, 2)] == [[0], [1]]
    assert facets.count == 2
    directions = rays(mirrors.model.intrinsics)[mirrors.views.window]
    planes = fit_facets(depth_mm.astype(np.float64), facets, mirrors.model.frame, directions)
    assert [plane.flat for plane in planes] == [False, False]
