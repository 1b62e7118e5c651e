"""A projector's gamma is measured on any object, and its table makes the light linear."""

import numpy as np
import pytest

from irpmd_rig.core import fringe_images
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.preparation.gamma import measure_gamma

COUNTS = (8.0, 7.0)
WIDTH, HEIGHT = 256, 128


def _seen(gamma: float, steps: int = 24, table: np.ndarray | None = None, top: float = 180.0) -> np.ndarray:
    """Frames of an object of uneven reflectance under uneven ambient light, 8 bits, 1.5 DN of noise."""
    rng = np.random.default_rng(7)
    shown = fringe_images(COUNTS, steps, (WIDTH, HEIGHT))
    shown = shown if table is None else table[shown]
    light = 0.1 + 0.9 * (shown / 255.0) ** gamma
    seen = rng.uniform(0, 20, (HEIGHT, WIDTH)) + rng.uniform(0.3, 1, (HEIGHT, WIDTH)) * top * light
    return np.clip(np.rint(seen + 1.5 * rng.standard_normal(seen.shape)), 0, 255).astype(np.uint8)


def _phase() -> np.ndarray:
    return np.tile(2 * np.pi * max(COUNTS) * (np.arange(WIDTH) + 0.5) / WIDTH, (HEIGHT, 1))


@pytest.mark.parametrize("gamma", [0.8, 1.0, 1.05, 2.2])
def test_gamma_is_found_and_its_table_makes_the_light_linear(gamma: float) -> None:
    found = measure_gamma(_seen(gamma), COUNTS, _phase())
    assert abs(found.gamma - gamma) < 4 * found.sigma_gamma + 2e-4 * gamma
    assert found.table.dtype == np.uint8
    assert np.all(np.diff(found.table.astype(int)) >= 0)
    again = measure_gamma(_seen(gamma, table=found.table), COUNTS, _phase())
    assert abs(again.gamma - 1) < 0.006
    straight = again.levels / 254
    assert np.sqrt(np.mean((again.light - straight) ** 2)) < 0.006


def test_a_linear_projector_keeps_its_levels() -> None:
    table = measure_gamma(_seen(1.0), COUNTS, _phase()).table.astype(int)
    assert np.abs(table - np.arange(256)).max() <= 1


def test_too_few_steps_are_refused() -> None:
    with pytest.raises(CalibrationError, match="at least 12 steps, and these have 8"):
        measure_gamma(_seen(1.0, steps=8), COUNTS, _phase())


def test_too_few_pixels_are_refused() -> None:
    phase = np.full((HEIGHT, WIDTH), np.nan)
    phase[:10, :10] = _phase()[:10, :10]
    with pytest.raises(CalibrationError, match="and 100 do"):
        measure_gamma(_seen(1.0), COUNTS, phase)


def test_light_that_does_not_grow_is_refused() -> None:
    frames = 255 - _seen(1.0)
    shifted = _phase()
    with pytest.raises(CalibrationError, match="does not grow with the level"):
        measure_gamma(frames, COUNTS, shifted)
