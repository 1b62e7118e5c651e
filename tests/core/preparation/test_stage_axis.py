"""The direction of the stage is found from traced phases, whatever the glass, the stage and the projector are."""

import numpy as np
import pytest

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.preparation.stage_axis import StageAxis, StageView, fit_stage_axis
from irpmd_rig.shipped import world_file
from sims.world import World, load_world
from tests.core.rig_truth import model_of, phases_of

SIZE_PX = 256
POSITIONS_MM = (0.0, -40.0, -80.0, 40.0)
SIGMA_RAD = 0.015


def _world(about_x_deg: float = 0.0, about_y_deg: float = 0.1, scale_ppm: float = 0.0) -> World:
    world = load_world(world_file("misaligned")).with_camera_size(SIZE_PX)
    stage = world.stage1.model_copy(
        update={
            "axis_tilt_about_x_deg": about_x_deg,
            "axis_tilt_about_y_deg": about_y_deg,
            "scale_error_ppm": scale_ppm,
        }
    )
    return world.model_copy(update={"stage1": stage})


def _views(world: World, positions_mm=POSITIONS_MM, *, with_y: bool = True, pixels: int = 800) -> list[StageView]:
    rng = np.random.default_rng(3)
    directions = model_of(world).directions().reshape(-1, 3)
    scale = 1 + 1e-6 * world.stage1.scale_error_ppm
    views = []
    true_mm = [position_mm * scale for position_mm in positions_mm]
    for told_mm, shown in zip(
        positions_mm, phases_of(world, "mirror", true_mm, sigma_rad=SIGMA_RAD, size_px=SIZE_PX), strict=True
    ):
        places = [np.flatnonzero(mask) for mask in (shown.reflected, shown.glass)]
        chosen = [rng.choice(place, min(pixels, place.size), replace=False) for place in places]
        every = np.concatenate(chosen)
        views.append(
            StageView(
                told_mm,
                directions[every],
                np.arange(every.size) < chosen[0].size,
                shown.phase_rad.reshape(-1)[every],
                shown.phase_y_rad.reshape(-1)[every] if with_y else None,
            )
        )
    return views


def _found(world: World, **choices) -> StageAxis:
    model = model_of(world)
    a, b, c = model.glass
    # The search begins where a calibration leaves it, not at the truth.
    return fit_stage_axis(_views(world, **choices), model.frame.camera_mm, (a + 1e-3, b - 1e-3, c + 0.2))


@pytest.mark.parametrize(("about_x_deg", "about_y_deg"), [(0.0, 0.1), (-0.3, 0.05)])
def test_direction_and_glass_come_out_within_their_uncertainty(about_x_deg: float, about_y_deg: float) -> None:
    world = _world(about_x_deg, about_y_deg)
    found, truth = _found(world), model_of(world)
    errors = found.axis[:2] - truth.stage_axis[:2]
    assert np.all(np.abs(errors) < 4 * np.array(found.sigma_rad))
    assert max(found.sigma_rad) < 20e-6
    assert found.rms_rad == pytest.approx(SIGMA_RAD, rel=0.1)
    assert np.abs(np.array(found.glass[:2]) - truth.glass[:2]).max() < 5e-5


def test_a_stage_that_goes_too_far_shows_in_the_scale() -> None:
    found = _found(_world(scale_ppm=500.0))
    assert abs(found.scale - 1.0005) < 4 * found.sigma_scale
    assert found.sigma_scale < 5e-5
    # Straight and even: nothing is left but noise.
    assert np.abs(found.off_line_mm).max() < 5e-3


def test_the_search_begins_where_the_glass_was_when_its_place_was_found() -> None:
    world = _world()
    model = model_of(world)
    a, b, c = model.glass
    views = _views(world, (40.0, -40.0, 0.0))
    for at_mm in (-300.0, -80.0, 0.0, 150.0):
        found = fit_stage_axis(views, model.frame.camera_mm, (a, b, c + at_mm), at_mm)
        assert np.abs(found.axis[:2] - model.stage_axis[:2]).max() < 5e-5
        assert found.glass[2] == pytest.approx(c, abs=0.05)


def test_fringes_along_x_alone_leave_the_direction_along_y_open() -> None:
    found = _found(_world(), positions_mm=(0.0, 40.0), with_y=False)
    assert found.sigma_rad[0] < 1e-4
    assert found.sigma_rad[1] > 1e-3


def test_one_position_is_refused() -> None:
    world = _world()
    with pytest.raises(CalibrationError, match="needs two positions"):
        fit_stage_axis(_views(world, (0.0,)), model_of(world).frame.camera_mm, model_of(world).glass)


def test_a_position_at_which_nothing_is_seen_is_named() -> None:
    world = _world()
    near, far = _views(world, (0.0, 40.0))
    bare = StageView(40.0, far.directions[:10], far.reflected[:10], far.phase_rad[:10], None)
    with pytest.raises(CalibrationError, match="at 40 mm only 10 pixels"):
        fit_stage_axis([near, bare], model_of(world).frame.camera_mm, model_of(world).glass)
