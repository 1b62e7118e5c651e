"""A pixel that cannot be known is invalid, never a plausible number."""

import numpy as np
import pytest
from fringe_reference import columns, fringes

from irpmd_rig.core.phase import decode, wrapped_phases

COUNTS = (64, 63, 56)


def scene(kind="uint8", height=40, width=128):
    frames = np.rint(fringes(COUNTS, columns(width, height), 4, 120, 90)).astype(kind)
    rng = np.random.default_rng(0)
    return frames + rng.integers(0, 2, frames.shape).astype(kind)


def test_phase_is_nan_exactly_where_it_is_not_valid():
    frames = scene()
    frames[:, :, 10:20] = 50
    absolute = decode(frames, COUNTS)
    np.testing.assert_array_equal(np.isnan(absolute.phase_rad), ~absolute.valid)
    np.testing.assert_array_equal(np.isnan(absolute.sigma_rad), ~absolute.valid)
    assert not absolute.valid[10:20].any()
    assert absolute.valid[:10].all()
    assert absolute.valid[20:].all()
    assert np.all(absolute.modulation_dn[10:20] == 0)


def test_the_gate_lies_at_14_sigma():
    rng = np.random.default_rng(1)
    modulation = np.linspace(0, 60, 400)[:, None]
    frames = fringes(COUNTS, columns(512, 400), 4, 127, modulation)
    frames = np.rint(frames + rng.normal(0, 1.5, frames.shape)).astype(np.uint8)
    absolute = decode(frames, COUNTS)
    sigma = np.sqrt(1.5**2 + 1 / 12)
    assert absolute.least_modulation_dn == pytest.approx(14 * sigma, rel=0.05)
    assert absolute.valid[modulation[:, 0] > 18 * sigma].all()
    assert not absolute.valid[modulation[:, 0] < 11 * sigma].any()
    error = absolute.phase_rad - 2 * np.pi * 64 * columns(512)
    assert np.nanmax(np.abs(error)) < np.pi


def test_an_explicit_threshold_replaces_the_gate():
    frames = scene()
    assert decode(frames, COUNTS, min_modulation_dn=80).valid.all()
    assert not decode(frames, COUNTS, min_modulation_dn=95).valid.any()


@pytest.mark.parametrize("dark", range(3))
def test_every_set_must_have_its_modulation(dark):
    frames = scene()
    frames[dark, :, :, 30:60] = 120
    valid = decode(frames, COUNTS).valid
    assert not valid[:, 30:60].any()
    assert valid[:, :30].all()


@pytest.mark.parametrize("steps", range(3, 13))
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_no_modulation_is_never_a_phase_even_if_any_modulation_is_allowed(steps, kind):
    for value in (0, 37, 200):
        frames = np.full((3, steps, 5, 7), value, kind)
        for options in ({}, {"min_modulation_dn": 0.0}):
            absolute = decode(frames, COUNTS, **options)
            assert not absolute.valid.any()
            assert np.isnan(absolute.phase_rad).all()
        assert np.isnan(wrapped_phases(frames).phase_rad).all()


@pytest.mark.parametrize(("kind", "full"), [("uint8", 255), ("uint16", 1023)])
def test_one_saturated_step_makes_a_pixel_invalid(kind, full):
    frames = scene(kind)
    frames[1, 2, 7, 9] = full
    frames[1, 2, 7, 11] = full - 1
    frames[0, 0, 7, 11] = full - 1
    valid = decode(frames, COUNTS, min_modulation_dn=1).valid
    assert not valid[7, 9]
    assert valid[7, 10]
    expected = np.full(valid.shape, True)
    expected[7, [9, 11]] = False, valid[7, 11]
    np.testing.assert_array_equal(valid, expected)


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("threshold", [200.0, 199.5, 1e6])
def test_saturation_dn_is_where_saturation_begins(kind, threshold):
    frames = scene(kind)
    absolute = decode(frames, COUNTS, saturation_dn=threshold)
    np.testing.assert_array_equal(absolute.valid, (frames < threshold).all(axis=(0, 1)))


def test_float_frames_do_not_saturate_unless_told():
    assert decode(100 * scene("float32"), COUNTS).valid.all()


def test_orders_that_contradict_each_other_make_a_pixel_invalid():
    """Half a turn added to the coarse beat puts the next rung's rounding exactly between two orders."""
    position = columns(128, 40)
    frames = fringes(COUNTS, position, 4)
    other = fringes(COUNTS, position, 4)[2, [2, 3, 0, 1]]
    frames[2, :, 5:10] = other[:, 5:10]
    valid = decode(frames.astype(np.float32), COUNTS).valid
    assert not valid[5:10].any()
    assert valid[10:].all()


def test_scaling_the_frames_does_not_change_what_is_valid():
    frames = scene("float32")
    frames[:, :, 10:20] = 50
    for factor in (1e-3, 1.0, 1e3):
        scaled = decode(frames * np.float32(factor), COUNTS)
        np.testing.assert_array_equal(scaled.valid, decode(frames, COUNTS).valid)
