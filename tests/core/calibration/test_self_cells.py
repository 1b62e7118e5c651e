"""Phase maps condensed to cells: only pixels of the region count, and what is too narrow for a cell is left out."""

import numpy as np
import pytest

from irpmd_rig.core.calibration.rig_calibration import RigView
from irpmd_rig.core.calibration.self_cells import condense

SHAPE = (1000, 1009)


def view(glass: np.ndarray, phase_rad: np.ndarray) -> RigView:
    nothing = np.zeros(SHAPE, np.bool_)
    return RigView(0.0, phase_rad, 0.01, nothing, nothing, glass)


def ramp() -> np.ndarray:
    return (0.05 * np.arange(SHAPE[1]) * np.ones((SHAPE[0], 1))).astype(np.float32)


def test_a_strip_beyond_the_last_whole_cell_has_none() -> None:
    strip = np.zeros(SHAPE, np.bool_)
    strip[:, 1000:] = True
    assert len(condense([view(strip, ramp())])) == 0


def test_pixels_outside_the_region_do_not_count() -> None:
    glass = np.zeros(SHAPE, np.bool_)
    glass[200:800, 300:700] = True
    phase = np.where(glass, ramp(), ramp() + 0.02)
    cells = condense([view(glass, phase)])
    assert len(cells) > 1000
    np.testing.assert_allclose(cells.phase_rad, 0.05 * cells.pixel[:, 0], atol=1e-4)


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_outlying_pixels_are_left_out(share: float) -> None:
    glass = np.zeros(SHAPE, np.bool_)
    glass[200:800, 300:700] = True
    wrong = np.random.default_rng(1).random(SHAPE) < share
    cells = condense([view(glass, np.where(wrong, ramp() + 6.0, ramp()))])
    np.testing.assert_allclose(cells.phase_rad, 0.05 * cells.pixel[:, 0], atol=1e-4)
