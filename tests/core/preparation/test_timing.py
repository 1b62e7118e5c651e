"""Delays of displays and rest of stages, from frames."""

import numpy as np
import pytest

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.preparation.timing import display_delay, light_share, settling, stage_offset_mm

TIMES_S = np.array([0.0, 0.01, 0.02, 0.03, 0.05])


def test_the_delay_lies_between_the_last_frame_without_all_light_and_the_next() -> None:
    found = display_delay(TIMES_S[::-1], np.array([0.0, 0.2, 0.99, 1.0, 1.0])[::-1])
    assert (found.before_s, found.until_s) == (0.01, 0.02)


def test_light_that_flickers_later_counts() -> None:
    assert display_delay(TIMES_S, np.array([1.0, 1.0, 0.9, 1.0, 1.0])).until_s == 0.03


def test_light_that_is_there_at_once() -> None:
    found = display_delay(TIMES_S + 0.004, np.ones(5))
    assert (found.before_s, found.until_s) == (0.0, 0.004)


def test_light_that_is_never_all_there_is_refused() -> None:
    with pytest.raises(CalibrationError, match="50 ms after the order only 60 %"):
        display_delay(TIMES_S, np.array([0.0, 0.1, 0.2, 0.3, 0.6]))


def test_the_share_of_light_is_that_of_the_lit_pixels() -> None:
    black = np.full((40, 40), 5, np.uint8)
    white = black.copy()
    white[:, 10:] = 205
    frame = black.copy()
    frame[:, 10:] = 55
    assert light_share(frame, black, white) == pytest.approx(0.25)
    with pytest.raises(CalibrationError, match="no brighter than a black one"):
        light_share(frame, black, black)


def _ringing(times_s: np.ndarray) -> np.ndarray:
    return 0.020 * np.exp(-times_s / 0.05) * np.sin(2 * np.pi * 25 * times_s)


def test_a_ringing_stage_rests_when_its_ringing_has_died_down() -> None:
    times_s = 0.001 + 0.011 * np.arange(60)
    noise_mm = 1e-4 * np.random.default_rng(0).standard_normal(60)
    found = settling(times_s, 0.3 + _ringing(times_s) + noise_mm, 1e-3)
    # The ringing's envelope falls to 1 um after 0.05 ln 20 = 0.150 s.
    assert 0.10 < found.settle_s < 0.165
    assert found.sigma_mm < 2e-4


def test_a_stage_that_does_not_rest_has_no_settle_time() -> None:
    times_s = 0.011 * np.arange(60)
    found = settling(times_s, 0.01 * np.sin(40 * times_s), 1e-3)
    assert np.isnan(found.settle_s)


def test_a_stage_that_rests_at_once() -> None:
    assert settling(TIMES_S, np.zeros(5), 1e-3).settle_s == 0.0


@pytest.mark.parametrize("off_mm", [0.0, 0.005, -0.05])
def test_the_offset_is_seen_in_one_fringe_picture(off_mm: float) -> None:
    rng = np.random.default_rng(1)
    phase = np.tile(np.linspace(0, 200, 300), (100, 1))
    growth, modulation, mean = np.full(phase.shape, 0.9), np.full(phase.shape, 80.0), np.full(phase.shape, 100.0)
    # The light is 1 % brighter than it was: no movement.
    frame = 1.01 * (mean + modulation * np.cos(phase + growth * off_mm)) + 2 * rng.standard_normal(phase.shape)
    wrapped = np.angle(np.exp(1j * phase))
    assert stage_offset_mm(frame, wrapped, modulation, mean, growth) == pytest.approx(off_mm, abs=6e-4)


def test_a_picture_without_fringes_tells_no_offset() -> None:
    flat = np.zeros((50, 50))
    with pytest.raises(CalibrationError, match="too few pixels"):
        stage_offset_mm(flat, flat, flat, flat, flat)
