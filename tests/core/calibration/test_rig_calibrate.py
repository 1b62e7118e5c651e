"""The rig calibrates itself: exact phases give the exact rig, noisy ones errors of the stated size."""

from functools import cache

import numpy as np
import pytest

from irpmd_rig.core.calibration.rig_calibrate import calibrate_rig
from irpmd_rig.core.calibration.rig_calibration import RigCalibration
from irpmd_rig.core.calibration.rig_stage_offset import stage_offset
from tests.core.calibration.rig_scene import (
    PROJECTOR,
    SIGMA_RAD,
    Scene,
    facet_errors,
    scene_of,
    turned_world,
    view_of,
)
from tests.core.rig_truth import phases_of


@cache
def calibrated(seed: int, *, bow_um: float = 0.0, warp_px: float = 0.0) -> tuple[Scene, RigCalibration]:
    scene = scene_of(turned_world(seed, bow_um=bow_um, warp_px=warp_px, mirrored=seed % 2 == 1), seed)
    return scene, calibrate_rig(scene.views, scene.camera, scene.geometry, PROJECTOR)


def measured(scene: Scene, calibration: RigCalibration) -> np.ndarray:
    """Errors (um, urad, urad) of tilted treads from exact phases at 0 and 40 mm, true positions 2 and 1 um off."""
    shown = phases_of(scene.world, "mirror_step_tilted", [0.002, 39.999], size_px=None)
    offsets = [stage_offset(calibration.model, view_of(one, one.stage1_mm, SIGMA_RAD)).offset_mm for one in shown]
    return facet_errors(calibration.model, shown, offsets)


@pytest.mark.parametrize("mirrored", [False, True])
def test_exact_phases_give_the_exact_rig(mirrored: bool) -> None:
    scene = scene_of(turned_world(7, mirrored=mirrored), 7, sigma_rad=0.0, stage_noise_mm=0.0, stated_rad=1e-4)
    calibration = calibrate_rig(scene.views, scene.camera, scene.geometry, PROJECTOR)
    model, truth = calibration.model, scene.truth
    assert calibration.chi2_per_dof < 1e-2
    assert not calibration.flexible
    assert model.intrinsics.focal_px[0] == pytest.approx(truth.intrinsics.focal_px[0], abs=2e-4)
    assert model.frame.camera_mm == pytest.approx(truth.frame.camera_mm, abs=2e-4)
    assert model.stage_axis == pytest.approx(truth.stage_axis, abs=2e-6)
    x, y = np.meshgrid(np.linspace(40, 210, 9), np.linspace(-90, 90, 9))
    on_glass = np.stack([x, y, truth.glass_z_mm(x, y)], axis=-1)
    assert model.glass_z_mm(x, y) == pytest.approx(truth.glass_z_mm(x, y), abs=2e-4)
    assert model.phase_rad(on_glass, on_glass=True) == pytest.approx(truth.phase_rad(on_glass, on_glass=True), abs=2e-4)
    assert np.abs(measured(scene, calibration)).max() < 0.02


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_seen_through_a_noisy_calibration(seed: int) -> None:
    scene, calibration = calibrated(seed)
    assert 0.9 < calibration.chi2_per_dof < 1.1
    assert calibration.chi2_by_region.keys() == {"mirror", "sprayed", "glass"}
    errors = measured(scene, calibration)
    assert np.abs(np.diff(errors[:, 0])).max() < 0.3
    assert np.abs(errors).max() < 1.5


def test_stated_uncertainties_are_the_actual_errors() -> None:
    squares = []
    for seed in range(3):
        scene, calibration = calibrated(seed)
        assert calibration.inflation < 1.3  # white noise
        covariance = glass_scatter(calibration)
        error = glass_heights(calibration.model) - glass_heights(scene.truth)
        squares.append(error @ np.linalg.solve(covariance, error) / len(error))
    assert 0.3 < np.mean(squares) < 2.0


def glass_heights(model: object) -> np.ndarray:
    x, y = np.array([60.0, 200.0, 60.0]), np.array([-80.0, 0.0, 80.0])
    return model.glass_z_mm(x, y)


def glass_scatter(calibration: RigCalibration) -> np.ndarray:
    moved = [glass_heights(one) - glass_heights(calibration.model) for one in calibration.variations]
    return np.einsum("ki,kj->ij", moved, moved)


def test_variations_and_parameters_tell_the_same() -> None:
    _, calibration = calibrated(0)
    places = [[one.name for one in calibration.parameters].index(f"glass.{name}") for name in ("slope_x", "slope_y")]
    moved = np.array([np.array(one.glass[:2]) - calibration.model.glass[:2] for one in calibration.variations])
    stated = calibration.covariance[np.ix_(places, places)]
    assert np.einsum("ki,kj->ij", moved, moved) == pytest.approx(stated, rel=1e-6)
    sigmas = [calibration.parameters[place].sigma for place in places]
    assert sigmas == pytest.approx(np.sqrt(np.diag(stated)))


@pytest.mark.parametrize("disturbance", [{"bow_um": 20.0}, {"warp_px": 0.25}])
def test_what_the_numbers_cannot_express_is_seen_and_taken_up(disturbance: dict[str, float]) -> None:
    scene, calibration = calibrated(5, **disturbance)
    assert calibration.flexible
    assert 0.8 < calibration.chi2_per_dof < 1.2
    errors = measured(scene, calibration)
    assert np.abs(np.diff(errors[:, 0])).max() < 0.8
    assert np.abs(errors[:, 0]).max() < 2.0


def test_what_x_fringes_cannot_tell_is_said() -> None:
    _, calibration = calibrated(0)
    said = " ".join(calibration.undetermined)
    assert "row of the projector's principal point" in said
    assert "scale of lengths" in said


def test_residual_maps_are_of_unit_scatter() -> None:
    _, calibration = calibrated(0)
    for residual, view in zip(calibration.residuals, calibrated(0)[0].views, strict=True):
        assert residual.stage1_mm == view.stage1_mm
        known = residual.sigmas[np.isfinite(residual.sigmas)]
        assert known.size > 500
        assert known.std() == pytest.approx(1.0, abs=0.1)


def test_outlying_pixels_do_not_move_the_rig() -> None:
    scene, calibration = calibrated(0)
    rng = np.random.default_rng(0)
    spoiled = []
    for view in scene.views:
        phase = view.phase_rad.copy()
        phase[rng.random(phase.shape) < 0.01] += 2 * np.pi
        spoiled.append(type(view)(view.stage1_mm, phase, view.sigma_rad, view.mirror, view.sprayed, view.glass))
    again = calibrate_rig(spoiled, scene.camera, scene.geometry, PROJECTOR)
    assert again.chi2_per_dof < 1.15
    moved = 1e3 * np.abs(glass_heights(again.model) - glass_heights(calibration.model))
    assert moved.max() < 0.3
