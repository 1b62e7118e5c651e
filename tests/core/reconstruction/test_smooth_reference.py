"""The reference mirror's phase without its noise."""

import numpy as np
import pytest

from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.reconstruction.smooth_reference import smooth_reference


def mirror_phase(height=400, width=520):
    """A homography's row, a little bent: what a straight fringe looks like in a mirror."""
    v, u = np.meshgrid(np.linspace(-0.3, 0.3, height), np.linspace(-0.35, 0.35, width), indexing="ij")
    return 200 + 330 * (u + 0.05 * v) / (1 + 0.55 * u + 0.1 * v) + 0.8 * u**3


def test_noise_falls_and_the_shape_stays():
    truth = mirror_phase()
    rng = np.random.default_rng(5)
    noisy = (truth + rng.normal(0, 0.015, truth.shape)).astype(np.float32)
    smooth = smooth_reference(noisy)
    error = smooth.phase_rad - truth
    assert np.sqrt(np.mean(error**2)) < 0.0005
    assert smooth.noise_rad == pytest.approx(0.015, rel=0.02)
    assert smooth.coherent_rad < 0.002


def test_holes_are_bridged_the_outside_stays_unknown():
    truth = mirror_phase()
    phase = truth.copy()
    phase[:, 400:] = np.nan
    phase[100:106, 200:206] = np.nan
    region = np.ones(truth.shape, bool)
    region[:50] = False
    smooth = smooth_reference(phase, region=region)
    assert np.isnan(smooth.phase_rad[:, 401:]).all()
    assert np.isnan(smooth.phase_rad[:50]).all()
    assert np.abs(smooth.phase_rad - truth)[60:390, 10:390].max() < 1e-3


def test_too_little_mirror_is_refused():
    phase = np.full((100, 100), np.nan)
    phase[:20, :20] = 1.0
    with pytest.raises(FramesError, match="400 pixels"):
        smooth_reference(phase)
