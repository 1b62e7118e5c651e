"""What exposures and fringes of several widths tell of camera and lenses."""

import numpy as np
import pytest

from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.preparation.exposure import exposure_curve
from irpmd_rig.core.preparation.focus import sharpness

TIMES_US = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0)


def _pairs(bend: float = 0.0, electrons_a_dn: float = 53.0, read_dn: float = 0.5, rate: float = 0.05) -> list:
    rng = np.random.default_rng(0)
    scene = np.linspace(0.02, 1, 300)[None, :] * np.ones((200, 1))
    pairs = []
    for time_us in TIMES_US:
        light = rate * time_us * scene
        light = light * (1 - bend * light / 255)
        sigma = np.sqrt(read_dn**2 + light / electrons_a_dn)
        frames = [np.clip(np.rint(light + sigma * rng.standard_normal(light.shape)), 0, 255) for _ in range(2)]
        pairs.append(tuple(frame.astype(np.uint8) for frame in frames))
    return pairs


def test_a_linear_camera_is_told_so_with_its_noise_and_the_best_exposure() -> None:
    found = exposure_curve(_pairs(), TIMES_US, 255.0)
    assert found.recommended_us == pytest.approx(0.85 * 255 / 0.05, rel=0.02)
    assert found.nonlinearity < 0.005
    assert found.shot_dn == pytest.approx(1 / 53, rel=0.1)
    assert found.noise_floor_dn == pytest.approx(0.5, abs=0.1)
    assert found.saturated[-1] > 0.3
    assert not found.saturated[:4].any()


def test_a_camera_that_is_not_linear_shows() -> None:
    assert exposure_curve(_pairs(bend=0.2), TIMES_US, 255.0).nonlinearity > 0.02


def test_exposures_that_all_saturate_recommend_nothing() -> None:
    found = exposure_curve(_pairs(rate=2.0), TIMES_US, 255.0)
    assert np.isnan(found.recommended_us)
    assert np.isnan(found.nonlinearity)


def test_darkness_and_equal_exposures_are_refused() -> None:
    with pytest.raises(CalibrationError, match="nothing is lit at 8000 us"):
        exposure_curve(_pairs(rate=1e-5), TIMES_US, 255.0)
    with pytest.raises(CalibrationError, match="exposures must rise"):
        exposure_curve(_pairs()[:2], (500.0, 500.0), 255.0)


def test_blur_is_found_from_what_is_left_of_the_contrast() -> None:
    counts = np.array([16.0, 32.0, 64.0, 128.0])
    # Twice as blurred in the lower half of the picture; nothing is lit on the right.
    blur = np.repeat([0.6 / 1024, 1.2 / 1024], 64)[:, None] * np.ones((1, 128))
    modulation = 80 * np.exp(-2 * np.pi**2 * blur**2 * counts[:, None, None] ** 2)
    modulation[:, :, 96:] = 0.0
    modulation += 0.2 * np.random.default_rng(0).standard_normal(modulation.shape)
    found = sharpness(modulation, counts)
    cells = 1024 * found.blur_cells
    np.testing.assert_allclose(cells[:4, :6], 0.6, rtol=0.05)
    np.testing.assert_allclose(cells[4:, :6], 1.2, rtol=0.05)
    assert np.all(np.isnan(cells[:, 6:]))
    assert found.contrast[0] == 1.0
    assert np.all(np.diff(found.contrast) < 0)


def test_a_picture_without_fringes_has_no_sharpness() -> None:
    with pytest.raises(CalibrationError, match="no fringes are seen"):
        sharpness(np.zeros((2, 50, 50)), (16, 64))
