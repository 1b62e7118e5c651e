"""Planes of facets by maximum likelihood: exact, as a plain solution finds them, and as uncertain as they say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from irpmd_rig.core import Facets, find_facets, rays
from irpmd_rig.core.errors import EvaluationError, FramesError
from irpmd_rig.core.evaluation.step_report import steps_of
from irpmd_rig.core.reconstruction.facet_estimate import Doubts, estimate_surfaces
from irpmd_rig.core.reconstruction.reflected_phase import reflected_phase, reflected_phase_and_gradient
from irpmd_rig.core.reconstruction.triangulation import triangulate
from sims.truth import true_planes_mm, true_steps_mm
from tests.core.seen_objects import DEPTH_SIGMA_MM, SIGMA_RAD, misaligned, seen


@pytest.fixture(scope="module")
def treads():
    return seen("mirror_step_y")


@pytest.fixture(scope="module")
def facets(treads):
    return find_facets(treads.depth_with(DEPTH_SIGMA_MM, 0).depth_mm)


def estimated(treads, facets, sigma_rad=SIGMA_RAD, sigma_mm=DEPTH_SIGMA_MM, seed=0, doubts=None, model=None):
    views, depth = treads.views_with(sigma_rad, seed), treads.depth_with(sigma_mm, seed)
    return estimate_surfaces(views, depth, facets, model or treads.model, doubts)


@pytest.mark.parametrize("name", ["mirror_step_x", "freeform"])
@pytest.mark.parametrize("along_y", [False, True])
def test_the_reflected_phase_is_the_traced_one(name, along_y):
    shown = seen(name, (0.0, 40.0), with_y=True)
    known = shown.facet >= 0
    model, window = shown.model, shown.views.window
    directions = rays(model.intrinsics)[window][known]
    points = (shown.truth.point_mm[window][known] - model.frame.camera_mm) @ model.frame.axes
    normals = shown.truth.normal[window][known] @ model.frame.axes
    tangents = normals / (normals * points).sum(axis=1, keepdims=True)
    for index, position in enumerate(shown.views.positions_mm):
        maps = shown.views.phases_y_rad if along_y else shown.views.phases_rad
        phase, gradient = reflected_phase_and_gradient(model, directions, tangents, position, along_y=along_y)
        np.testing.assert_allclose(phase, maps[index][known], atol=1e-8)
        change = 1e-8 * np.random.default_rng(0).standard_normal(tangents.shape)
        moved = reflected_phase(model, directions, tangents + change, position, along_y=along_y)
        np.testing.assert_allclose(moved - phase, (gradient * change).sum(axis=1), atol=1e-6)


@pytest.mark.parametrize("name", ["mirror_step_y", "fan_x"])
def test_planes_are_exact_without_noise(name):
    shown = seen(name, size_px=512)
    found = find_facets(shown.depth_with(0.0, 0).depth_mm)
    estimate = estimated(shown, found, 0.0, 0.0)
    planes = true_planes_mm(shown.world, name)
    assert [facet.kind for facet in estimate.facets] == ["plane"] * len(planes)
    for facet, plane in zip(estimate.facets, planes, strict=True):
        assert facet.height_mm == pytest.approx(plane @ (1.0, *facet.centre_mm), abs=1e-6)
        np.testing.assert_allclose(facet.slope, plane[1:], atol=1e-7)
    np.testing.assert_allclose(steps_of(estimate).values_mm, true_steps_mm(shown.world, name), atol=2e-6)
    inside = estimate.labels > 0
    np.testing.assert_allclose(estimate.depth_mm[inside], shown.depth_mm[inside], atol=3e-6)
    assert estimate.piston == "phases"
    assert np.isnan(estimate.depth_mm[~inside]).all()


def plain_phase(model, directions, plane, position):
    """The same optics written out anew: z = h + p x + q y, seen from the camera, mirrored, on the glass."""
    height, p, q = plane
    camera = model.frame.camera_mm
    reach = (height + p * camera[0] + q * camera[1] - camera[2]) / (directions @ [-p, -q, 1.0])
    points = camera + reach[:, None] * directions
    normal = np.array([-p, -q, 1.0]) / np.sqrt(1 + p * p + q * q)
    leaving = directions - 2 * (directions @ normal)[:, None] * normal
    points = points + position * model.stage_axis
    a, b, c = model.glass
    go = (a * points[:, 0] + b * points[:, 1] + c - points[:, 2]) / (leaving @ [-a, -b, 1.0])
    return model.phase_rad(points + go[:, None] * leaving, on_glass=True)


def test_a_plain_least_squares_solution_agrees_in_value_and_uncertainty(treads, facets):
    views, depth = treads.views_with(SIGMA_RAD, 5), treads.depth_with(DEPTH_SIGMA_MM, 5)
    third = np.where(facets.labels == 3, 1, 0).astype(np.int32)
    estimate = estimate_surfaces(views, depth, Facets(third, 1, 0.08), treads.model).facets[0]
    mask = third == 1
    directions = treads.model.directions()[views.window][mask]

    def residual(plane):
        return np.concatenate(
            [
                (phase[mask] - plain_phase(treads.model, directions, plane, position)) / SIGMA_RAD
                for position, phase in zip(views.positions_mm, views.phases_rad, strict=True)
            ]
        )

    start = true_planes_mm(treads.world, "mirror_step_y")[2]
    solution = least_squares(residual, start, x_scale=[1e-3, 1e-5, 1e-5], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(solution.fun).max() < 5  # nothing that the estimate would have clipped
    functional = np.array([1.0, *estimate.centre_mm])
    height, sigma = functional @ solution.x, functional @ np.linalg.solve(solution.jac.T @ solution.jac, functional)
    assert estimate.height_mm == pytest.approx(height, abs=2e-5)
    np.testing.assert_allclose(estimate.slope, solution.x[1:], atol=2e-7)
    gradient = estimate.surface.gradient(estimate.centre_mm)
    chi2 = solution.fun @ solution.fun / (solution.fun.size - 3)
    assert estimate.chi2_per_dof == pytest.approx(chi2, rel=1e-3)
    stated = gradient @ estimate.surface.covariance @ gradient
    assert stated == pytest.approx(sigma * max(chi2, 1.0) * estimate.coherence, rel=1e-3)


def test_the_stated_random_uncertainty_and_its_correlation_hold(treads, facets):
    errors, covariances = [], []
    for seed in range(12):
        steps = steps_of(estimated(treads, facets, seed=seed))
        errors.append(steps.values_mm - true_steps_mm(treads.world, "mirror_step_y"))
        covariances.append(steps.covariance_mm2)
    whitened = [error @ np.linalg.solve(c, error) / error.size for error, c in zip(errors, covariances, strict=True)]
    assert 0.6 < np.mean(whitened) < 1.5
    stated = np.mean(covariances, axis=0)
    sigma = np.sqrt(np.diag(stated))
    # At 384 px a facet has 1/28 of the pixels that it has at full size, and loses half of them at its edges.
    assert sigma.max() < 1.2e-3 * np.sqrt(2 * 28) * 2
    assert (np.diag(stated, 1) / (sigma[1:] * sigma[:-1]) < -0.3).all()


def test_stage_positions_that_scatter_are_part_of_the_random_uncertainty(treads, facets):
    quiet = steps_of(estimated(treads, facets)).random_mm
    shaken = steps_of(estimated(treads, facets, doubts=Doubts(sigma_position_mm=5e-3)))
    exact = steps_of(estimated(treads, facets, 0.0, 0.0)).values_mm
    moved = replace(treads.views, positions_mm=(0.0, 40.005))
    other = steps_of(estimate_surfaces(moved, treads.depth_with(0.0, 0), facets, treads.model, Doubts(chi2_limit=1e9)))
    by_one = np.abs(other.values_mm - exact)
    assert (shaken.random_mm**2 - quiet**2 >= 0.8 * by_one**2).all()
    assert shaken.calibration_mm.max() == 0


def test_the_calibrations_part_is_what_another_calibration_would_give(treads, facets):
    a, b, c = treads.model.glass
    tilted = replace(treads.model, glass=(a + 2e-5, b - 1e-5, c + 0.02))
    turned = replace(treads.model, stage_axis=treads.model.stage_axis + np.array([3e-5, -2e-5, 0.0]))
    doubts = Doubts(variations=(tilted, turned))
    steps = steps_of(estimated(treads, facets, 0.0, 0.0, doubts=doubts))
    errors = [
        steps_of(estimated(treads, facets, 0.0, 0.0, doubts=Doubts(chi2_limit=np.inf), model=model)).values_mm
        for model in (tilted, turned)
    ]
    changes = np.array(errors) - steps.values_mm
    np.testing.assert_allclose(steps.calibration_covariance_mm2, changes.T @ changes, rtol=0.05, atol=(2e-5) ** 2)


def test_so_is_its_part_of_heights_by_triangulation(treads, facets):
    turned = replace(treads.model, stage_axis=treads.model.stage_axis + np.array([2e-4, -1e-4, 0.0]))
    views = treads.views_with(0.0, 0)

    def steps(model, *variations):
        doubts = Doubts(variations=variations, chi2_limit=0.0)
        return steps_of(estimate_surfaces(views, triangulate(views, model), facets, model, doubts))

    stated = steps(treads.model, turned)
    change = steps(turned).values_mm - stated.values_mm
    assert np.abs(change).max() > 3e-4
    np.testing.assert_allclose(stated.calibration_mm, np.abs(change), rtol=0.1, atol=2e-5)


def test_a_bowed_glass_that_the_model_does_not_know_is_noticed_and_triangulation_trusted():
    shown = seen("mirror_step_x", size_px=512, world=misaligned(glass={"bow_um": 100.0}))
    truth = true_steps_mm(shown.world, "mirror_step_x")
    found = find_facets(shown.depth_with(0.01, 0).depth_mm)
    estimate = estimated(shown, found, sigma_rad=0.002, sigma_mm=0.011)
    assert estimate.piston == "triangulation"
    assert any("the calibrated model is off" in remark for remark in estimate.remarks)
    assert estimate.disagreement > 3
    by_triangulation = np.abs(steps_of(estimate).values_mm - truth).max()
    shapes = [facet.kind for facet in estimate.facets]
    assert shapes == ["plane"] * 5
    assert by_triangulation < 4e-3


def test_outliers_and_unknown_pixels_do_no_harm(treads, facets):
    views = treads.views_with(SIGMA_RAD, 3)
    rng = np.random.default_rng(4)
    phases = [phase.copy() for phase in views.phases_rad]
    phases[0][rng.random(views.shape) < 0.02] += 2.0
    phases[1][rng.random(views.shape) < 0.02] = np.nan
    clean = estimate_surfaces(views, treads.depth_with(DEPTH_SIGMA_MM, 3), facets, treads.model)
    dirty = estimate_surfaces(
        replace(views, phases_rad=tuple(phases)), treads.depth_with(DEPTH_SIGMA_MM, 3), facets, treads.model
    )
    difference = steps_of(dirty).values_mm - steps_of(clean).values_mm
    assert (np.abs(difference) < steps_of(clean).random_mm).all()
    assert dirty.chi2_per_dof < 1.1


def test_facets_with_too_few_pixels_and_parts_that_leave_the_glass_are_said(treads, facets):
    labels = facets.labels.copy()
    rows, columns = np.nonzero(labels == 1)
    labels[rows[80:], columns[80:]] = 0
    views = treads.views_with(SIGMA_RAD, 0)
    part = views.phases_rad[1].copy()
    rows, columns = np.nonzero(labels == 4)
    part[rows[::2], columns[::2]] = np.nan
    views = replace(views, phases_rad=(views.phases_rad[0], part))
    estimate = estimate_surfaces(
        views, treads.depth_with(DEPTH_SIGMA_MM, 0), replace(facets, labels=labels), treads.model
    )
    assert [facet.facet for facet in estimate.facets] == [2, 3, 4, 5]
    assert "facet 1 is left out: 80 pixels" in estimate.remarks[0]
    assert "facet 4: at 40 mm only 50% of its pixels" in estimate.remarks[1]
    assert not (estimate.labels == 1).any()
    assert steps_of(estimate).names == ("2-3", "3-4", "4-5")


def test_a_facet_that_is_not_seen_at_one_of_three_positions_is_estimated_from_the_others():
    treads = seen("mirror_step_y", (0.0, 20.0, 40.0))
    facets = find_facets(treads.depth_with(DEPTH_SIGMA_MM, 0).depth_mm)
    views = treads.views_with(SIGMA_RAD, 0)
    gone = np.where(facets.labels == 2, np.nan, views.phases_rad[1])
    views = replace(views, phases_rad=(views.phases_rad[0], gone, views.phases_rad[2]))
    estimate = estimate_surfaces(views, treads.depth_with(DEPTH_SIGMA_MM, 0), facets, treads.model)
    assert [facet.facet for facet in estimate.facets] == [1, 2, 3, 4, 5]
    assert "facet 2: at 20 mm only 0% of its pixels" in estimate.remarks[0]
    steps = steps_of(estimate)
    error = steps.values_mm - true_steps_mm(treads.world, "mirror_step_y")
    assert (np.abs(error) < 4 * steps.sigma_mm).all()


def test_phases_that_determine_no_surface_are_said(treads, facets):
    views = treads.views_with(SIGMA_RAD, 0)
    torn = [np.where(facets.labels == 2, np.nan, phase) for phase in views.phases_rad]
    estimate = estimate_surfaces(
        replace(views, phases_rad=tuple(torn)), treads.depth_with(DEPTH_SIGMA_MM, 0), facets, treads.model
    )
    assert [facet.facet for facet in estimate.facets] == [1, 3, 4, 5]
    assert "facet 2 is left out: its phases do not determine a surface" in estimate.remarks


def test_what_cannot_be_estimated_is_refused(treads, facets):
    none = Facets(np.where(facets.labels == 9, 1, 0).astype(np.int32), 1, 0.08)
    with pytest.raises(EvaluationError, match="no facet could be estimated: facet 1 is left out: 0 pixels"):
        estimated(treads, none)
    with pytest.raises(FramesError, match="shape of the views"):
        estimated(treads, Facets(facets.labels[1:], facets.count, 0.08))
