"""Sets of views that cannot determine a rig: refused, with what to add."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.calibration.rig_calibrate import calibrate_rig
from irpmd_rig.core.calibration.rig_calibration import RigView
from irpmd_rig.core.calibration.rig_stage_offset import stage_offset
from irpmd_rig.core.errors import CalibrationError, FramesError
from tests.core.calibration.rig_scene import PROJECTOR, Scene, scene_of, turned_world


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(turned_world(3), 3)


def refused(scene: Scene, views: list[RigView], message: str, error: type[Exception] = CalibrationError) -> None:
    with pytest.raises(error, match=message):
        calibrate_rig(views, scene.camera, scene.geometry, PROJECTOR)


def test_one_stage_position(scene: Scene) -> None:
    first = scene.views[0]
    refused(scene, [first], r"add one that is tens of millimetres away")
    refused(scene, [first, first], r"add one that is tens of millimetres away")


@pytest.mark.parametrize(
    ("region", "message"),
    [("mirror", "glass's reflection in the mirror"), ("sprayed", "the sprayed mirror"), ("glass", "the glass itself")],
)
def test_a_region_that_is_not_seen(scene: Scene, region: str, message: str) -> None:
    nothing = np.zeros_like(scene.views[0].mirror)
    refused(scene, [replace(view, **{region: nothing}) for view in scene.views], message)


def test_a_mirror_seen_at_one_position_only(scene: Scene) -> None:
    nothing = np.zeros_like(scene.views[0].mirror)
    views = [scene.views[0], *(replace(view, mirror=nothing) for view in scene.views[1:])]
    refused(scene, views, "at one stage position only")


def test_maps_of_another_size(scene: Scene) -> None:
    short = replace(scene.views[1], phase_rad=scene.views[1].phase_rad[1:])
    refused(scene, [scene.views[0], short], "as the camera's picture", FramesError)


def test_no_glass_for_a_stage_offset(scene: Scene) -> None:
    nothing = np.zeros_like(scene.views[0].mirror)
    with pytest.raises(CalibrationError, match="glass directly at 0 mm"):
        stage_offset(scene.truth, replace(scene.views[0], glass=nothing))
