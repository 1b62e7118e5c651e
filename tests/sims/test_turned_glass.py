"""The screws of the ground glass: what they turn adds to the world's tilt, at the time at which they are turned."""

import numpy as np
import pytest

from sims.errors import SimulationError
from sims.optics import trace
from sims.rig import SimulatedRig
from sims.setup import Setup
from sims.world import World


def test_a_turned_glass_is_the_glass_of_a_world_with_that_tilt(ideal: World) -> None:
    small = ideal.with_camera_size(64)
    tilted = small.model_copy(
        update={"glass": small.glass.model_copy(update={"tilt_about_x_deg": 0.2, "tilt_about_y_deg": -0.3})}
    )
    seen = trace(small, Setup("mirror", glass_turn_deg=(0.2, -0.3)))
    np.testing.assert_array_equal(seen.lit_mm, trace(tilted, Setup("mirror")).lit_mm)


def test_turns_add_up_and_end_where_the_screws_do(ideal: World) -> None:
    rig = SimulatedRig(ideal)
    rig.turn_glass(0.5, -1.0)
    rig.turn_glass(0.25, 2.0)
    assert rig.setup.glass_turn_deg == (0.75, 1.0)
    with pytest.raises(SimulationError, match="at most 5 degrees"):
        rig.turn_glass(5.0, 0.0)
    assert rig.setup.glass_turn_deg == (0.75, 1.0)
