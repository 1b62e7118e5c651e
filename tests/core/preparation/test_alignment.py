"""The tilt of the glass against the mirror comes out of depths along the camera's rays."""

import numpy as np
import pytest

from irpmd_rig.core import Drawing, PlatePlacement, rays
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.preparation.alignment import SeenPlanes, glass_tilt
from irpmd_rig.shipped import world_file
from sims.optics import trace
from sims.setup import Setup
from sims.world import load_world
from tests.core.rig_truth import model_of

# A plate that lies square to the optical axis: its position is the depth, but for a constant.
PLACEMENT = PlatePlacement(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 300.0]), 0.0, (0.0, 0.0, 1.0))


def _seen(turned_deg: tuple[float, float], sigma_mm: float = 0.05) -> SeenPlanes:
    world = load_world(world_file("ideal")).with_camera_size(192)
    model = model_of(world)
    shown = trace(world, Setup("mirror", glass_turn_deg=turned_deg))
    depth = ((shown.point_mm - model.frame.camera_mm) @ model.frame.axes)[..., 2]
    depth += sigma_mm * np.random.default_rng(0).standard_normal(depth.shape)
    return SeenPlanes(depth - 300.0, rays(model.intrinsics), (shown.kind == 2), (shown.kind == 3))


@pytest.mark.parametrize("turned_deg", [(0.0, 0.0), (0.0, 0.1), (0.2, 0.0), (-0.15, -0.3)])
def test_the_tilt_is_what_the_screws_turned(turned_deg: tuple[float, float]) -> None:
    found = glass_tilt(_seen(turned_deg), PLACEMENT, 0.0, Drawing())
    errors = np.array([found.about_x_rad, found.about_y_rad]) - np.deg2rad(turned_deg)
    sigmas = np.array([found.sigma_about_x_rad, found.sigma_about_y_rad])
    assert np.all(np.abs(errors) < 4 * sigmas)
    assert np.all(sigmas < np.deg2rad(0.02))
    assert found.within(np.deg2rad(0.05)) == (max(np.abs(turned_deg)) < 0.05)


def test_a_plate_whose_tilt_is_not_well_known_is_in_the_uncertainty() -> None:
    seen = _seen((0.0, 0.1))
    sure, unsure = (glass_tilt(seen, PLACEMENT, sigma_rad, Drawing()) for sigma_rad in (0.0, 1e-3))
    assert unsure.about_y_rad == sure.about_y_rad
    assert unsure.sigma_about_y_rad > 2 * sure.sigma_about_y_rad
    tilted = PlatePlacement(np.array([1e-3, 0.0, -1.0]), PLACEMENT.point_mm, 0.0, PLACEMENT.axis)
    moved = glass_tilt(seen, tilted, 0.0, Drawing())
    assert abs(moved.about_y_rad - sure.about_y_rad) < 3 * unsure.sigma_about_y_rad


def test_a_glass_that_is_not_seen_is_named() -> None:
    seen = _seen((0.0, 0.0))
    nowhere = SeenPlanes(seen.position_mm, seen.rays, seen.mirror, np.zeros_like(seen.glass))
    with pytest.raises(CalibrationError, match="of 0 pixels of the glass only 0"):
        glass_tilt(nowhere, PLACEMENT, 0.0, Drawing())
