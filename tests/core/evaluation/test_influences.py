"""First-order influences against exact rays through a misaligned rig (in the plane y = 0)."""

import numpy as np
import pytest

from irpmd_rig.core import AlignmentTolerance, depth_influences, direct_depth

from .scene import FRAME, RAYS

D, TRAVEL = 180.0, 40.0
ROW = 160
DIRECTIONS = FRAME.directions(RAYS)[ROW : ROW + 1]
RAY_ROW = RAYS[ROW : ROW + 1]


def phase(height, slope, shift, *, axis=0.0, curvature=0.0, d=D, travel_error=0.0):
    """Phase that each ray sees in a mirror z = height + slope x, the glass shifted along the stage's axis."""
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    reach = (normal[2] * height - FRAME.camera_mm @ normal) / (DIRECTIONS @ normal)
    hit = FRAME.camera_mm + reach[..., None] * DIRECTIONS
    out = DIRECTIONS - 2 * (DIRECTIONS @ normal)[..., None] * normal
    actual = shift * (1 + travel_error / TRAVEL)
    x = hit[..., 0] + (d + actual - hit[..., 2]) / out[..., 2] * out[..., 0] - actual * axis - 125.0
    return x + 0.5 * curvature * x**2


def error_of(height, slope=0.0, **imperfect):
    """Error of the depth equation at the row's pixels, and its influences."""
    maps = tuple(
        phase(*surface, shift, **imperfect) for surface in ((0.0, 0.0), (height, slope)) for shift in (0.0, TRAVEL)
    )
    depth = direct_depth(*maps, d_mm=D, delta_d_mm=TRAVEL)
    ideal = tuple(phase(*surface, shift) for surface in ((0.0, 0.0), (height, slope)) for shift in (0.0, TRAVEL))
    exact = direct_depth(*ideal, d_mm=D, delta_d_mm=TRAVEL)
    tolerance = AlignmentTolerance(
        stage_axis_rad=imperfect.get("axis", 0.0), phase_curvature_per_mm=imperfect.get("curvature", 0.0)
    )
    influences = depth_influences(
        maps,
        depth,
        FRAME,
        RAY_ROW,
        d_mm=D,
        sigma_d_mm=0.05,
        sigma_delta_d_mm=imperfect.get("travel_error", 0.0),
        tolerance=tolerance,
    )
    return depth - exact, {influence.name: influence.change_mm for influence in influences}


@pytest.mark.parametrize("height", [-11.0, 7.0])
def test_an_axis_off_the_normal(height):
    error, influences = error_of(height, axis=np.deg2rad(0.1))
    np.testing.assert_allclose(np.abs(error), np.abs(influences["stage axis"]), rtol=0.05)


@pytest.mark.parametrize("height", [-11.0, 7.0])
def test_a_curved_phase(height):
    error, influences = error_of(height, curvature=1.05e-5)
    ratio = np.abs(error) / np.abs(influences["phase curvature"])
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0


def test_a_wrong_travel():
    error, influences = error_of(7.0, travel_error=0.01)
    np.testing.assert_allclose(-error, influences["delta_d"], rtol=0.01)


def test_a_wrong_d_matters_on_tilted_treads_only():
    for slope, least, most in ((0.0, 0.0, 1e-9), (0.0105, 1e-4, 1e-2)):
        maps = tuple(phase(*surface, shift) for surface in ((0, 0), (5.0, slope)) for shift in (0.0, TRAVEL))
        moved = direct_depth(*maps, d_mm=D + 0.05, delta_d_mm=TRAVEL) - direct_depth(*maps, d_mm=D, delta_d_mm=TRAVEL)
        change = error_of(5.0, slope)[1]["d"]
        np.testing.assert_allclose(moved, change, atol=1e-12)
        assert least <= np.abs(change).max() <= most
