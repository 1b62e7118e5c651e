"""Decoding inverts the fringes: for every set of counts that the methods can use, at every number of steps."""

import numpy as np
import pytest
from fringe_reference import columns, fringes, hierarchical, optimum
from hypothesis import given, settings
from hypothesis import strategies as st

from irpmd_rig.core.phase import decode


@st.composite
def optimum_counts(draw, steepest=200):
    """Counts with whole beats that start at 1, no rung steeper than a ratio, in any order."""
    finest = draw(st.integers(2, 200))
    beats = [1]
    while finest / beats[-1] > steepest or (len(beats) < 4 and beats[-1] + 1 < finest and draw(st.booleans())):
        beats.append(draw(st.integers(beats[-1] + 1, min(beats[-1] * steepest, finest - 1))))
    return tuple(draw(st.permutations([finest] + [finest - beat for beat in beats])))


@st.composite
def hierarchical_counts(draw):
    counts = [draw(st.floats(0.1, 1))]
    for _ in range(draw(st.integers(0, 4))):
        counts.append(counts[-1] * draw(st.floats(1.2, 10)))
    return tuple(draw(st.permutations(counts)))


def tolerance(counts, units=1.5):
    # Units in the last place of the largest phase in float32, which the ladder also works in; the polynomial.
    return units * np.spacing(np.float32(2 * np.pi * max(counts))) + 1e-5


unhurried = settings(deadline=None)  # the first call compiles

scenes = {
    "steps": st.integers(3, 12),
    "mean": st.floats(100, 400),
    "modulation": st.floats(20, 100),
    "width": st.integers(1, 300),
    "height": st.integers(1, 3),
}


@unhurried
@given(counts=optimum_counts(), **scenes)
def test_optimum_recovers_the_phase_from_end_to_end_of_the_projector(counts, steps, mean, modulation, width, height):
    position = columns(width, height)
    frames = fringes(counts, position, steps, mean, modulation).astype(np.float32)
    absolute = decode(frames, counts)
    assert absolute.valid.all()
    np.testing.assert_allclose(absolute.phase_rad, 2 * np.pi * max(counts) * position, atol=tolerance(counts), rtol=0)
    np.testing.assert_allclose(absolute.modulation_dn, modulation, rtol=5e-5)


@unhurried
@given(counts=hierarchical_counts(), **scenes)
def test_hierarchical_recovers_the_phase_for_any_real_counts(counts, steps, mean, modulation, width, height):
    position = columns(width, height)
    frames = fringes(counts, position, steps, mean, modulation).astype(np.float32)
    absolute = decode(frames, counts, unwrapping="hierarchical")
    assert absolute.valid.all()
    np.testing.assert_allclose(absolute.phase_rad, 2 * np.pi * max(counts) * position, atol=tolerance(counts), rtol=0)


@unhurried
@given(counts=optimum_counts(steepest=12), seed=st.integers(0, 99), kind=st.sampled_from(["uint8", "uint16"]), **scenes)
def test_whole_numbers_with_noise_decode_as_a_plain_float64_implementation_does(
    counts, seed, kind, steps, mean, modulation, width, height
):
    rng = np.random.default_rng(seed)
    modulation = 40 + modulation / 2
    frames = fringes(counts, rng.random((height, width)), steps, 127 if kind == "uint8" else mean, modulation)
    frames = np.rint(frames + rng.normal(0, 0.5, frames.shape)).clip(0, 254 if kind == "uint8" else 1022)
    absolute = decode(frames.astype(kind), counts, min_modulation_dn=5)
    phase, strength = optimum(frames, counts)
    good = absolute.valid
    period = 2 * np.pi * max(counts)
    # The two may fall on different sides of the outermost wrap.
    difference = np.mod(absolute.phase_rad - phase + period / 2, period) - period / 2
    assert good.mean() > 0.9 or width * height < 30
    assert np.abs(difference[good]).max(initial=0) < tolerance(counts)
    np.testing.assert_allclose(absolute.modulation_dn, strength, rtol=5e-5)


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_hierarchical_agrees_with_a_plain_float64_implementation(steps):
    rng = np.random.default_rng(steps)
    counts = (0.9, 3.9, 15.9, 63.9)
    frames = fringes(counts, rng.random((90, 101)), steps)
    frames = np.rint(frames + rng.normal(0, 1.5, frames.shape)).astype(np.uint8)
    absolute = decode(frames, counts, unwrapping="hierarchical")
    phase, strength = hierarchical(frames, counts)
    assert absolute.valid.all()
    np.testing.assert_allclose(absolute.phase_rad, phase, atol=tolerance(counts), rtol=0)
    np.testing.assert_allclose(absolute.modulation_dn, strength, rtol=5e-5)


@pytest.mark.parametrize(
    "counts", [(64, 63, 56), (56, 64, 63), (36, 35, 30), (100, 99, 90), (64, 63), (64, 63, 60, 48), (2, 1)]
)
def test_known_sets_of_counts_in_whatever_order(counts):
    position = columns(1024)
    absolute = decode(fringes(counts, position, 4).astype(np.float32), counts)
    assert absolute.valid.all()
    assert absolute.counts == counts
    np.testing.assert_allclose(
        absolute.phase_rad, 2 * np.pi * max(counts) * position, atol=tolerance(counts, 0.5), rtol=0
    )


def test_at_the_very_ends_only_the_outermost_wrap_is_open():
    """Noise at phase 0 may show as the last turn's end, never as one of the orders between."""
    rng = np.random.default_rng(3)
    position = rng.choice([0.0, 1e-6, 1 - 1e-6, 1.0], (64, 64))
    frames = fringes((64, 63, 56), position, 4) + rng.normal(0, 1.5, (3, 4, 64, 64))
    absolute = decode(np.rint(frames).astype(np.uint8), (64, 63, 56))
    end = np.minimum(absolute.phase_rad, 2 * np.pi * 64 - absolute.phase_rad)
    assert absolute.valid.all()
    assert np.abs(end).max() < 0.05
    assert absolute.phase_rad.min() >= 0
    assert absolute.phase_rad.max() <= np.float32(2 * np.pi * 64)


def test_hierarchical_from_one_whole_period_folds_the_ends_too():
    rng = np.random.default_rng(4)
    position = np.where(rng.random((50, 50)) < 0.5, 0.0005, 0.9995)
    frames = fringes((1, 8, 64), position, 4) + rng.normal(0, 1.5, (3, 4, 50, 50))
    absolute = decode(np.rint(frames).astype(np.uint8), (1, 8, 64), unwrapping="hierarchical")
    assert absolute.valid.all()
    np.testing.assert_allclose(absolute.phase_rad, 2 * np.pi * 64 * position, atol=0.08)


def test_the_phase_is_the_inverse_variance_mean_of_all_sets():
    """A small error of one set's phase enters by its weight c_k c_0 / sum c^2."""
    counts = np.array([64, 63, 56])
    position = np.full((4, 4), 0.3)
    exact = decode(fringes(counts, position, 4).astype(np.float32), counts).phase_rad.astype(float)
    for k in range(3):
        frames = fringes(counts, position, 4)
        angle = 2 * np.pi * (counts[k] * position + np.arange(4)[:, None, None] / 4) + 0.01
        frames[k] = 127 + 100 * np.cos(angle)
        shift = decode(frames.astype(np.float32), counts).phase_rad - exact
        expected = 0.01 * counts[k] * 64 / np.square(counts).sum()
        np.testing.assert_allclose(shift, expected, atol=1e-4)
