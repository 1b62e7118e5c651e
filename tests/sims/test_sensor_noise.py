"""The noise generator: Gaussian, its own for every frame and pixel, the same on any number of threads."""

import numpy as np
import pytest
from scipy import stats

from sims.sensor import frame_key, gaussian_row, words_row

ROWS, COLUMNS = 512, 2048


def noise(seed: int, frame: int) -> np.ndarray:
    out = np.empty((ROWS, COLUMNS), np.float32)
    key = frame_key(seed, frame)
    for row in range(ROWS):
        gaussian_row(key, row, out[row])
    return out


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return np.stack([noise(1, frame) for frame in range(4)])


def test_moments_are_those_of_a_unit_gaussian(frames: np.ndarray) -> None:
    n = frames[0].size
    for frame in frames.astype(np.float64):
        assert abs(frame.mean()) < 5 / np.sqrt(n)
        assert abs(frame.var() - 1) < 5 * np.sqrt(2 / n)
        assert abs(stats.skew(frame.ravel())) < 5 * np.sqrt(6 / n)
        assert abs(stats.kurtosis(frame.ravel())) < 5 * np.sqrt(24 / n)


def test_distribution_is_gaussian_far_into_its_tails(frames: np.ndarray) -> None:
    sample = frames.ravel().astype(np.float64)
    assert stats.kstest(sample, "norm").pvalue > 1e-4
    for sigma in (3.0, 4.0, 4.75):
        expected = sample.size * 2 * stats.norm.sf(sigma)
        assert (np.abs(sample) > sigma).sum() == pytest.approx(expected, abs=6 * np.sqrt(expected) + 1)


def test_neighbours_rows_and_frames_are_independent(frames: np.ndarray) -> None:
    bound = 5 / np.sqrt(frames[0].size)
    a = frames[0].astype(np.float64)
    for other in (
        frames[1],
        frames[3],
        noise(2, 0),
        np.roll(a, 1, axis=1),
        np.roll(a, 1, axis=0),
        np.roll(a, COLUMNS // 2, axis=1),
    ):
        assert abs((a * other).mean()) < bound
        assert abs(((a**2 - 1) * (other.astype(np.float64) ** 2 - 1)).mean()) < 2 * bound


def test_noise_is_a_function_of_seed_frame_and_pixel() -> None:
    assert np.array_equal(noise(7, 3), noise(7, 3))
    assert not np.array_equal(noise(7, 3)[0], noise(7, 4)[0])
    assert not np.array_equal(noise(7, 3)[0], noise(8, 3)[0])


def words(
    electrons: float, *, shot: float = 0, read: float = 0, full_well: float = 10_000, gain: float = 1, gamma: float = 1
) -> np.ndarray:
    row, out = np.full(200_000, electrons, np.float32), np.empty(200_000, np.uint16)
    unit = np.empty_like(row)
    gaussian_row(frame_key(0, 0), 0, unit)
    scale = np.array([shot, read**2, full_well, gain * 1023 / full_well, 1023, 1 / gamma], np.float32)
    words_row(row, unit, *scale, out)
    return out


def test_variance_is_shot_noise_plus_read_noise() -> None:
    sample = words(5000, shot=1, read=30) * (10_000 / 1023)
    quantisation = (10_000 / 1023) ** 2 / 12
    assert sample.mean() == pytest.approx(5000, abs=1)
    assert sample.var() == pytest.approx(5000 + 900 + quantisation, rel=0.02)


def test_words_clip_at_both_ends_of_the_scale_and_at_the_full_well() -> None:
    assert words(20_000).max() == 1023
    assert words(0, read=50).min() == 0
    # A gain below one cannot show more than the well holds.
    assert words(20_000, gain=0.5).max() == 512


def test_camera_gamma_bends_the_scale_between_its_ends() -> None:
    assert words(2500, gamma=2.0)[0] == round(1023 * np.sqrt(0.25))
    assert words(10_000, gamma=2.0)[0] == 1023
    assert words(0, gamma=2.0)[0] == 0
