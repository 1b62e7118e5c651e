"""Rigs of other sizes, lenses and senses, and regions that do not fit: calibrated, or said what is off."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.calibration.rig_calibrate import calibrate_rig
from irpmd_rig.core.calibration.rig_calibration import RigCalibration, RigView
from irpmd_rig.core.calibration.self_cells import condense
from irpmd_rig.core.calibration.self_paths import modelled_phase
from irpmd_rig.core.camera import rays_at
from sims.world import World
from tests.core.calibration.rig_scene import PROJECTOR, SIGMA_RAD, Scene, scene_of, turned_world

WIDTH, HEIGHT = PROJECTOR.size_px


def with_lens(world: World, factor: float) -> World:
    """A projector of another focal length so much farther off that its picture is as large; strongly distorting."""
    lens = world.projector
    throw_mm = 1670.0 * factor
    other = {
        "focal_mm": factor * lens.focal_mm,
        "position_mm": (80.0, 0.0, 180.0 + throw_mm),
        "tilt_pivot_mm": throw_mm,
        "distortion": tuple(factor**2 * k for k in lens.distortion),
        "tilt_about_x_deg": 3.0,
        "tilt_about_y_deg": -3.0,
        "roll_deg": -3.0,
    }
    changed = world.model_copy(update={"projector": lens.model_copy(update=other)})
    return World.model_validate(changed.model_dump())


def calibrated(scene: Scene) -> RigCalibration:
    return calibrate_rig(scene.views, scene.camera, scene.geometry, PROJECTOR)


def glass_errors_um(calibration: RigCalibration, scene: Scene) -> np.ndarray:
    x, y = np.array([60.0, 200.0, 60.0]), np.array([-80.0, 0.0, 80.0])
    return 1e3 * (calibration.model.glass_z_mm(x, y) - scene.truth.glass_z_mm(x, y))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_focal_length_of_the_projector_need_not_be_known(factor: float) -> None:
    scene = scene_of(with_lens(turned_world(22), factor), 22)
    calibration = calibrated(scene)
    assert not calibration.flexible
    assert 0.9 < calibration.chi2_per_dof < 1.1
    focal_px = scene.truth.projector.focal_px[0]
    assert calibration.model.projector.focal_px[0] == pytest.approx(focal_px, rel=5e-3)
    assert np.abs(glass_errors_um(calibration, scene)).max() < 8


def test_a_picture_that_is_shifted_by_the_lens() -> None:
    scene = scene_of(turned_world(4), 4)
    shift_px = 90.0
    add_rad = 2 * np.pi * PROJECTOR.count * shift_px / WIDTH
    views = tuple(replace(view, phase_rad=view.phase_rad + add_rad) for view in scene.views)
    calibration = calibrated(replace(scene, views=views))
    assert 0.9 < calibration.chi2_per_dof < 1.1
    principal_px = calibration.model.projector.principal_point_px[0]
    assert principal_px == pytest.approx((WIDTH - 1) / 2 + shift_px, abs=5)


def along_y(scene: Scene, per_column: float, shift_px: float) -> Scene:
    """The scene with fringes along y of a projector with so many rows to a column's width, its picture shifted."""
    rng = np.random.default_rng(0)

    def view_of(view, true):
        row = true.projector_px[..., 1] * per_column + shift_px
        phase = 2 * np.pi * PROJECTOR.count * (row + 0.5) / HEIGHT
        return replace(view, phase_y_rad=phase + SIGMA_RAD * rng.standard_normal(phase.shape))

    seen = [one.trace for one in scene.shown]
    return replace(scene, views=tuple(view_of(view, true) for view, true in zip(scene.views, seen, strict=True)))


@pytest.mark.parametrize("per_column", [1.0, 2.0])
def test_the_shape_of_the_projectors_pixels_is_found_from_fringes_along_y(per_column: float) -> None:
    scene = along_y(scene_of(turned_world(6), 6), per_column, 40.0)
    calibration = calibrated(scene)
    assert calibration.along_y
    assert 0.9 < calibration.chi2_per_dof < 1.1
    fx, fy = calibration.model.projector.focal_px
    assert fy / fx == pytest.approx(per_column, rel=1e-4)
    x, y = np.meshgrid(np.linspace(40, 210, 5), np.linspace(-90, 90, 5))
    on_glass = np.stack([x, y, scene.truth.glass_z_mm(x, y)], axis=-1)
    row = scene.truth.projector.pixels(on_glass)[..., 1] * per_column + 40.0
    true_rad = 2 * np.pi * PROJECTOR.count * (row + 0.5) / HEIGHT
    assert calibration.model.phase_y_rad(on_glass) == pytest.approx(true_rad, abs=0.01)


def test_without_fringes_along_y_the_shape_of_the_pixels_is_said_to_be_open() -> None:
    calibration = calibrated(scene_of(turned_world(6), 6))
    assert not calibration.along_y
    assert "the height of the projector's pixels over their width" in " ".join(calibration.undetermined)


def test_a_spray_that_does_not_fit_is_left_out_and_told() -> None:
    scene = scene_of(turned_world(0), 0)
    rows, columns = np.indices(scene.views[0].phase_rad.shape)
    wrong_rad = 0.2 * np.sin(columns / 9.0) * np.cos(rows / 13.0)
    views = tuple(
        replace(view, phase_rad=view.phase_rad + np.where(view.sprayed, wrong_rad, 0.0)) for view in scene.views
    )
    calibration = calibrated(replace(scene, views=views))
    assert not calibration.flexible  # glass and mirror need no free-form terms
    assert calibration.chi2_by_region["sprayed"] > 100
    assert 0.8 < calibration.chi2_by_region["glass"] < 1.2
    assert "what the sprayed mirror tells" in calibration.undetermined[0]
    assert np.abs(glass_errors_um(calibration, scene)).max() < 10


def test_with_free_form_terms_the_sprays_chi2_is_told() -> None:
    calibration = calibrated(scene_of(turned_world(5, bow_um=20.0), 5))
    assert calibration.flexible
    assert calibration.chi2_by_region.keys() == {"mirror", "sprayed", "glass"}


def strip_of_glass(scene: Scene, width_px: int) -> RigView:
    view = scene.views[1]
    left = int(np.median(np.nonzero(view.glass)[1])) // 4 * 4
    strip = np.zeros_like(view.glass)
    strip[:, left : left + width_px] = True
    nothing = np.zeros_like(strip)
    return replace(view, mirror=nothing, sprayed=nothing, glass=view.glass & strip)


@pytest.fixture(scope="module")
def noiseless() -> Scene:
    return scene_of(turned_world(1), 1, sigma_rad=0.0, stage_noise_mm=0.0)


@pytest.mark.parametrize("width_px", [5, 9])
def test_the_mean_phase_of_a_narrow_strip_belongs_to_its_mean_pixel(noiseless: Scene, width_px: int) -> None:
    view = strip_of_glass(noiseless, width_px)
    cells = condense([view])
    assert len(cells) > 60
    rays = rays_at(noiseless.truth.intrinsics, cells.pixel)
    true_rad = modelled_phase(noiseless.truth, cells, rays, np.full(len(cells), view.stage1_mm))
    assert np.abs(cells.phase_rad - true_rad).max() < 0.3 * SIGMA_RAD / cells.side_px


def test_what_is_narrower_than_a_cell_does_not_count(noiseless: Scene) -> None:
    assert len(condense([strip_of_glass(noiseless, 3)])) == 0
