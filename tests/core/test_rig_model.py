"""The rig's model against the traced world: every kind of light path, with turned and mirrored parts."""

import numpy as np
import pytest

from irpmd_rig.core import rays
from irpmd_rig.shipped import world_file
from sims.world import World, load_world
from tests.core.rig_truth import model_of, phases_of

SIZE_PX = 256


def turned(world: World, **projector: object) -> World:
    """Every turn there is, about both axes and with either sign."""
    return World.model_validate(
        world.model_copy(
            update={
                "glass": world.glass.model_copy(update={"tilt_about_x_deg": -0.4, "tilt_about_y_deg": 0.3}),
                "stage1": world.stage1.model_copy(update={"axis_tilt_about_x_deg": 0.2, "axis_tilt_about_y_deg": -0.5}),
                "projector": world.projector.model_copy(
                    update={"tilt_about_x_deg": -0.7, "roll_deg": 2.0, **projector}
                ),
                "camera": world.camera.model_copy(update={"roll_deg": 1.5}),
            }
        ).model_dump()
    )


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("stage1_mm", [-40.0, 25.0])
def test_the_phase_of_what_is_lit_is_the_projectors(mirrored: bool, stage1_mm: float) -> None:
    world = turned(load_world(world_file("misaligned")), mirrored=mirrored)
    model = model_of(world.with_camera_size(SIZE_PX))
    (shown,) = phases_of(world, "mirror", [stage1_mm], size_px=SIZE_PX)
    lit = model.still(shown.trace.lit_mm, stage1_mm)
    for seen, on_glass in ((shown.reflected, True), (shown.glass, True), (shown.diffuse, False)):
        assert np.count_nonzero(seen) > 300
        assert np.abs(model.phase_rad(lit[seen], on_glass=on_glass) - shown.phase_rad[seen]).max() < 1e-9
        assert np.abs(model.phase_y_rad(lit[seen]) - shown.phase_y_rad[seen]).max() < 1e-9
    for seen in (shown.reflected, shown.glass):
        assert np.abs(model.glass_z_mm(*lit[seen][:, :2].T) - lit[seen][:, 2]).max() < 1e-9


def test_the_camera_sees_points_along_its_directions() -> None:
    world = turned(load_world(world_file("misaligned"))).with_camera_size(SIZE_PX)
    model = model_of(world)
    (shown,) = phases_of(world, "mirror", [0.0], size_px=None)
    seen = shown.reflected
    directions = model.directions()[seen]
    reach = (shown.trace.point_mm[seen][:, 2] - model.frame.camera_mm[2]) / directions[:, 2]
    points = model.frame.camera_mm + reach[:, None] * directions
    assert np.abs(points - shown.trace.point_mm[seen]).max() < 1e-9
    assert rays(model.intrinsics).shape == (SIZE_PX, SIZE_PX, 3)
