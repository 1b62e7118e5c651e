"""The depth equation: exact in an ideal rig, for every sign and tilt, and honest where it cannot be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from irpmd_rig.core import direct_depth
from irpmd_rig.core.errors import FramesError, MeasurementError

CAMERA = np.array([-160.0, 0.0, 330.0])
D = 180.0


def glass_x(height, slope_x, slope_y, shift, d):
    """Where on the glass (z = d + shift) the camera sees, mirrored in a plane z = height + slopes; exact vectors."""
    points_x = np.linspace(0, 70, 12)[None, :]
    points_y = np.linspace(-30, 30, 9)[:, None]
    ground = np.stack(np.broadcast_arrays(points_x, points_y, 0.0), axis=-1)
    ray = ground - CAMERA
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    reach = (normal[2] * height - CAMERA @ normal) / (ray @ normal)
    hit = CAMERA + reach[..., None] * ray
    out = ray - 2 * (ray @ normal)[..., None] * normal
    onto = (d + shift - hit[..., 2]) / out[..., 2]
    return hit[..., 0] + onto * out[..., 0], hit[..., 2]


heights = st.floats(-15, 15)
slopes = st.floats(-0.05, 0.05)
travels = st.floats(5, 80) | st.floats(-80, -5)
rates = st.floats(0.2, 2) | st.floats(-2, -0.2)


@given(heights, slopes, slopes, travels, rates, st.floats(-1e3, 1e3), st.floats(120, 400))
def test_exact_for_flat_and_tilted_surfaces_moved_away_and_toward_in_either_phase_direction(
    height, slope_x, slope_y, travel, rate, offset, d
):
    phases = []
    for surface in ((0.0, 0.0, 0.0), (height, slope_x, slope_y)):
        for shift in (0.0, travel):
            x, z = glass_x(*surface, shift, d)
            phases.append(rate * x + offset)
    h = direct_depth(*phases, d_mm=d, delta_d_mm=travel)
    np.testing.assert_allclose(h, z, rtol=0, atol=2e-9)


def test_below_a_billionth_of_a_millimetre_in_the_rig_of_the_paper():
    for travel in (40.0, -60.0):
        for direction in (1, -1):
            maps = [
                direction * 2 * np.pi / 5.77 * glass_x(*surface, shift, D)[0]
                for surface in ((0, 0, 0), (7.0, 0.01, -0.02))
                for shift in (0.0, travel)
            ]
            truth = glass_x(7.0, 0.01, -0.02, 0.0, D)[1]
            h = direct_depth(*maps, d_mm=D, delta_d_mm=travel)
            assert np.abs(h - truth).max() < 1e-9


def test_the_printed_sign_of_the_paper_is_refuted_by_a_tilted_tread():
    maps = [glass_x(*surface, shift, D)[0] for surface in ((0, 0, 0), (5.0, 0.01, 0.0)) for shift in (0.0, 40.0)]
    r1, r2, m1, m2 = maps
    printed = (40.0 * (r1 - m1) + D * ((r1 - r2) - (m1 - m2))) / ((r1 - r2) + (m1 - m2))
    truth = glass_x(5.0, 0.01, 0.0, 0.0, D)[1]
    np.testing.assert_allclose(direct_depth(*maps, d_mm=D, delta_d_mm=40.0), truth, atol=1e-9)
    assert np.abs(printed - truth).max() > 1.0


def test_a_pixel_that_cannot_be_known_is_nan():
    r1, r2 = np.full((2, 3), 10.0), np.full((2, 3), 8.0)
    m1, m2 = np.full((2, 3), 5.0), np.full((2, 3), 3.5)
    m2[0, 0] = 7.0  # M = -R
    m1[0, 1] = np.nan
    r2[0, 2] = np.inf
    h = direct_depth(r1, r2, m1, m2, d_mm=100.0, delta_d_mm=10.0)
    assert np.isnan(h[0]).all()
    assert np.isfinite(h[1]).all()


def test_precision_follows_the_input():
    maps = [np.full((2, 2), value, np.float32) for value in (10, 8, 5, 3.5)]
    assert direct_depth(*maps, d_mm=1.0, delta_d_mm=1.0).dtype == np.float32
    maps[0] = maps[0].astype(np.float64)
    assert direct_depth(*maps, d_mm=1.0, delta_d_mm=1.0).dtype == np.float64
    assert direct_depth(*([[[3, 1]]] * 3), [[1, 2]], d_mm=1, delta_d_mm=1).dtype == np.float64


@pytest.mark.parametrize(
    ("d_mm", "delta_d_mm", "says"),
    [
        (0.0, 40.0, "positive distance"),
        (np.nan, 40.0, "d_mm must be a finite number"),
        ("180", 40.0, "d_mm must be a finite number"),
        (180.0, None, "delta_d_mm must be a finite number"),
        (180.0, 0.0, "other than 0"),
        (180.0, np.inf, "delta_d_mm must be a finite number"),
        (180.0, -180.0, "through the glass"),
    ],
)
def test_impossible_distances_are_refused(d_mm, delta_d_mm, says):
    phase = np.ones((2, 2))
    with pytest.raises(MeasurementError, match=says):
        direct_depth(phase, phase, phase, phase, d_mm=d_mm, delta_d_mm=delta_d_mm)


@pytest.mark.parametrize(
    "odd", [np.ones((2, 3)), np.ones(4), np.ones((2, 2), complex), np.array([["a", "b"]]), [[1, 2], [3]]]
)
def test_maps_of_another_shape_or_type_are_refused(odd):
    phase = np.ones((2, 2))
    with pytest.raises(FramesError):
        direct_depth(phase, phase, phase, odd, d_mm=1.0, delta_d_mm=1.0)


def test_masked_pixels_are_unknown_ones():
    maps = [np.full((1, 2), value) for value in (10.0, 8.0, 5.0, 3.5)]
    maps[2] = np.ma.masked_array(maps[2], [[False, True]])
    h = direct_depth(*maps, d_mm=100.0, delta_d_mm=10.0)
    assert np.isfinite(h[0, 0])
    assert np.isnan(h[0, 1])


def test_a_height_behind_the_glass_is_no_height():
    maps = [np.full((1, 1), value) for value in (100.0, 80.0, 100.0, 120.000001)]
    assert np.isnan(direct_depth(*maps, d_mm=180.0, delta_d_mm=40.0)).all()
