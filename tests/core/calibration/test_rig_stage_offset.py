"""The stage's true position from the glass that the camera sees past the object."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.calibration.rig_stage_offset import stage_offset
from tests.core.calibration.rig_scene import SIGMA_RAD, turned_world, view_of
from tests.core.rig_truth import model_of, phases_of


def test_exact_phases_give_the_exact_offset() -> None:
    world = turned_world(2)
    (shown,) = phases_of(world, "mirror_step_y", [-59.997], size_px=None)
    found = stage_offset(model_of(world), view_of(shown, -60.0, SIGMA_RAD))
    assert found.offset_mm == pytest.approx(0.003, abs=1e-8)


def test_noise_gives_errors_of_the_stated_size() -> None:
    world = turned_world(2)
    model = model_of(world)
    scores = []
    for seed in range(8):
        (shown,) = phases_of(world, "mirror_step_y", [40.001], sigma_rad=SIGMA_RAD, seed=seed, size_px=None)
        found = stage_offset(model, view_of(shown, 40.0, SIGMA_RAD))
        assert found.sigma_mm < 1e-4
        scores.append((found.offset_mm - 0.001) / found.sigma_mm)
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.8


def test_what_another_rig_would_make_of_the_offset() -> None:
    world = turned_world(2)
    model = model_of(world)
    (shown,) = phases_of(world, "mirror_step_y", [40.001], sigma_rad=SIGMA_RAD, seed=1, size_px=None)
    view = view_of(shown, 40.0, SIGMA_RAD)
    found = stage_offset(model, view)
    a, b, c = model.glass
    others = [
        replace(model, glass=(a, b, c + 0.005)),
        replace(model, glass=(a + 2e-5, b, c)),
        replace(model, stage_axis=model.stage_axis + np.array([5e-5, 0.0, 0.0])),
    ]
    told = [stage_offset(other, view).offset_mm - found.offset_mm for other in others]
    assert np.abs(told).min() > 3e-4
    assert found.shifts_mm(others) == pytest.approx(np.array(told), rel=0.02)
