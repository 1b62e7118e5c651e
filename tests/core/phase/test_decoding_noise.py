"""How precise a decoded phase is, and that decode knows it."""

import numpy as np
import pytest
from fringe_reference import columns, fringes

from irpmd_rig.core.phase import NoiseModel, decode

COUNTS = (64, 63, 56)


def noisy(steps, modulation=100.0, sigma=1.5, size=(500, 1024), seed=0, counts=COUNTS, mean=127.0):
    rng = np.random.default_rng(seed)
    frames = fringes(counts, columns(size[1], size[0]), steps, mean, modulation)
    return np.rint(frames + rng.normal(0, 1, frames.shape) * sigma).clip(0, 255).astype(np.uint8)


def errors(absolute, width=1024, count=64):
    return absolute.phase_rad - 2 * np.pi * count * columns(width)


def test_four_steps_at_a_noise_of_1_5_dn_reach_7_mrad_without_one_wrong_order():
    absolute = decode(noisy(4), COUNTS)
    error = errors(absolute)
    assert absolute.valid.all()
    assert np.abs(error).max() < np.pi
    assert error.std() <= 0.0070


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_stated_sigma_holds_against_the_actual_error(steps):
    absolute = decode(noisy(steps), COUNTS)
    chi2 = np.mean((errors(absolute) / absolute.sigma_rad) ** 2)
    assert chi2 == pytest.approx(1, abs=0.1)


def test_stated_sigma_holds_for_hierarchical_unwrapping():
    counts = (0.9, 3.9, 15.9, 63.9)
    absolute = decode(noisy(4, counts=counts), counts, unwrapping="hierarchical")
    chi2 = np.mean((errors(absolute, count=63.9) / absolute.sigma_rad) ** 2)
    assert chi2 == pytest.approx(1, abs=0.1)


def test_shot_noise_is_told_from_read_noise_where_the_light_varies():
    light = np.linspace(10, 130, 1024)
    frames = noisy(4, 0.8 * light, np.sqrt(1 + 0.03 * light), mean=light)
    noise = decode(frames, COUNTS).noise
    for a in (20, 60, 120):
        # Rounding to whole numbers adds 1/12.
        assert noise.variance_dn2(np.float32(a)) == pytest.approx(1 + 0.03 * a + 1 / 12, rel=0.1)


@pytest.mark.parametrize("steps", [3, 4, 8])
def test_stated_sigma_holds_at_every_contrast(steps):
    """Fine fringes lose contrast by the camera's blur, but no light: their noise is that of the light."""
    contrast = np.where(np.arange(1024) < 512, 0.9, 0.35)
    light = np.linspace(130, 60, 500)[:, None] * np.ones(1024)
    absolute = decode(noisy(steps, contrast * light, np.sqrt(0.2 + 0.03 * light), mean=light), COUNTS)
    pull = errors(absolute) / absolute.sigma_rad
    for part in (pull[:100, :512], pull[-100:, :512], pull[:100, 512:], pull[-100:, 512:]):
        assert np.mean(part[np.isfinite(part)] ** 2) == pytest.approx(1, abs=0.12)


def test_noise_of_a_small_bright_object_in_a_dark_picture_is_found():
    modulation = np.zeros((500, 1024))
    modulation[200:300, 400:600] = 90
    sigma = np.where(modulation > 0, 2.0, 0.7)
    absolute = decode(noisy(4, modulation, sigma, mean=np.where(modulation > 0, 110.0, 10.0)), COUNTS)
    assert absolute.noise.variance_dn2(np.float32(110)) == pytest.approx(4 + 1 / 12, rel=0.15)
    np.testing.assert_array_equal(absolute.valid, modulation > 0)


@pytest.mark.parametrize("steps", [4, 8])
def test_fringes_distorted_by_a_gamma_are_not_taken_for_noise(steps):
    rng = np.random.default_rng(5)
    frames = fringes(COUNTS, columns(1024, 400) + 0.002 * np.arange(400)[:, None] / 400, steps, 0.5, 0.45)
    frames = 230 * frames**1.5 + rng.normal(0, 1.0, frames.shape)
    noise = decode(np.rint(frames).astype(np.uint8), COUNTS).noise
    assert noise.variance_dn2(np.float32(90)) == pytest.approx(1 + 1 / 12, rel=0.15)


def test_without_any_noise_what_is_left_is_the_rounding_to_whole_numbers():
    noise = decode(noisy(4, sigma=0.0), COUNTS).noise
    assert (noise.floor_dn2, noise.slope_dn) == (pytest.approx(1 / 12), 0.0)


def test_two_sets_of_a_steep_ladder_ask_for_more_modulation():
    """From 1 straight to 64 a rung multiplies the noise by 90: at B = 14 sigma every order would be a guess."""
    steep = decode(noisy(4, counts=(64, 63), sigma=0.5), (64, 63))
    gentle = decode(noisy(4, sigma=0.5), COUNTS)
    assert steep.least_modulation_dn > 5 * gentle.least_modulation_dn
    assert steep.valid.all()
    assert np.abs(errors(steep)).max() < np.pi


def test_least_modulation_solves_its_equation():
    noise = NoiseModel(2.0, 0.05, dark_dn=30.0, light=1.4)
    b = noise.least_modulation_dn(14)
    assert b == pytest.approx(14 * np.sqrt(noise.variance_dn2(np.float32(30 + 1.4 * b))))
