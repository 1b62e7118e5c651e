import numpy as np
import pytest
from fringe_reference import columns, fringes, wrapped_turns

from irpmd_rig.core.phase import CameraResponse, wrapped_phases


@pytest.mark.parametrize("steps", [3, 4, 5, 8, 11])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_every_set_by_itself(steps, kind):
    rng = np.random.default_rng(steps)
    frames = np.rint(fringes((64, 63, 56), rng.random((31, 57)), steps)).astype(kind)
    wrapped = wrapped_phases(frames)
    turns, modulation = wrapped_turns(frames)
    difference = np.mod(wrapped.phase_rad - 2 * np.pi * turns + np.pi, 2 * np.pi) - np.pi
    assert np.abs(difference).max() < 3e-6
    np.testing.assert_allclose(wrapped.modulation_dn, modulation, rtol=2e-5)
    np.testing.assert_allclose(wrapped.mean_dn, frames.mean(axis=1), rtol=1e-5)
    for values in (wrapped.phase_rad, wrapped.modulation_dn, wrapped.mean_dn):
        assert values.shape == (3, 31, 57)
        assert values.dtype == np.float32


def test_phases_lie_in_minus_pi_to_pi_with_pi_included():
    frames = np.zeros((1, 4, 1, 3), np.uint8)
    frames[0, :, 0, 0] = 100, 100, 200, 100
    frames[0, :, 0, 1] = 200, 100, 100, 100
    frames[0, :, 0, 2] = 100, 100, 100, 200
    np.testing.assert_allclose(wrapped_phases(frames).phase_rad[0, 0], [np.pi, 0, np.pi / 2], atol=1e-6)


def test_the_cameras_response_is_applied_first():
    position = columns(64, 4)
    light = fringes((4,), position, 4, 100, 80)
    seen = (255 * (light / 255) ** 0.5).astype(np.float32)
    levels = np.linspace(0, 255, 2000)
    response = CameraResponse(levels, 255 * (levels / 255) ** 2)
    wrapped = wrapped_phases(seen, response=response)
    expected = np.angle(np.exp(2j * np.pi * 4 * position))
    np.testing.assert_allclose(wrapped.phase_rad[0], expected, atol=1e-4)
    np.testing.assert_allclose(wrapped.modulation_dn, 80, rtol=1e-4)
    np.testing.assert_allclose(wrapped.mean_dn, 100, rtol=1e-4)
