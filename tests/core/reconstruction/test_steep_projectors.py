"""A projector far off the glass's normal: the rounds of the triangulation follow the keystone of its light."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.reconstruction.triangulation import triangulate
from irpmd_rig.core.reconstruction.views import Views
from irpmd_rig.core.rig_model import RigModel
from tests.core.reconstruction.traced_views import rig_of, world_of

SIZE_PX = 64
POSITIONS_MM = (0.0, 40.0)
MIDDLE_MM = np.array([80.0, 0.0, 180.0])


def pitched(model: RigModel, pitch_deg: float) -> RigModel:
    """The projector turned about the middle of the glass, about x."""
    sine, cosine = np.sin(np.deg2rad(pitch_deg)), np.cos(np.deg2rad(pitch_deg))
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    projector = model.projector
    centre_mm = turn @ (projector.centre_mm - MIDDLE_MM) + MIDDLE_MM
    return replace(model, projector=replace(projector, axes=projector.axes @ turn.T, centre_mm=centre_mm))


def level_mirror(model: RigModel, height_mm: float) -> Views:
    directions = model.directions()
    reach = (height_mm - model.frame.camera_mm[2]) / directions[..., 2]
    points = model.frame.camera_mm + reach[..., None] * directions
    leaving = directions * (1.0, 1.0, -1.0)
    lit = [model.meet_glass(model.still(points, position), leaving) for position in POSITIONS_MM]
    phases = tuple(model.phase_rad(points, on_glass=True).astype(np.float32) for points in lit)
    sigmas = tuple(np.full(phase.shape, 0.01, np.float32) for phase in phases)
    return Views(POSITIONS_MM, phases, sigmas, (slice(0, SIZE_PX), slice(0, SIZE_PX)))


@pytest.mark.parametrize("pitch_deg", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("height_mm", [0.0, 30.0])
def test_the_height_is_right_to_a_micrometre(pitch_deg: float, height_mm: float) -> None:
    model = pitched(rig_of(world_of("ideal"), SIZE_PX), pitch_deg)
    depth = triangulate(level_mirror(model, height_mm), model, slope_rounds=0).depth_mm
    assert np.abs(depth - height_mm).max() < 1.2e-3
