"""The check of the frames says which frame is wrong, how and how surely, and is silent about good ones."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpmd_rig.core.errors import CountsError, FramesError, MeasurementError
from irpmd_rig.core.quality import check_frames

PAPER = (64, 63, 56)
COARSE_TO_FINE = (0.9, 3.9, 15.9, 63.9)
SHAPE = (100, 400)


def coordinate(shape, surface="smooth", low=0.06, high=0.94):
    """Place on the projector (0..1) that each pixel sees."""
    rows, columns = shape
    row, column = np.mgrid[:rows, :columns] / np.array([[[rows]], [[columns]]])
    u = column + 0.05 * np.sin(3 * row)
    if surface == "stepped":
        u = u + 0.08 * (np.floor(5 * row) % 2) + 0.1 * (column > 0.55)
    u = (u - u.min()) / (u.max() - u.min())
    return low + (high - low) * u


def clean_frames(counts=PAPER, steps=4, *, surface="smooth", gamma=1.05, modulation=85.0, dark=0.0, shape=SHAPE):
    """Frames without noise: rounded patterns through the projector's gamma onto an unevenly bright object."""
    u = coordinate(shape, surface)
    phase = 2 * np.pi * np.multiply.outer(np.array(counts, float), u)[:, None]
    pattern = np.round(127.5 + 127.5 * np.cos(phase + 2 * np.pi * np.arange(steps)[:, None, None] / steps)) / 255
    row, column = np.indices(shape)
    brightness = np.where(column < dark * shape[1], 0.02, 0.8 + 0.2 * np.cos(column / 70 + row / 31))
    return 8 + 2 * modulation * brightness * pattern**gamma


def recorded(frames, noise_dn=1.2, seed=0, dtype=np.uint8):
    noisy = frames + noise_dn * np.random.default_rng(seed).standard_normal(frames.shape)
    if dtype == np.float32:
        return noisy.astype(np.float32)
    return np.clip(np.round(noisy), 0, 255 if dtype == np.uint8 else 1023).astype(dtype)


def changed(frames, change):
    """Frames after `change(flat copy, flat original)`."""
    flat = frames.reshape(-1, *frames.shape[2:])
    copy = flat.copy()
    change(copy, flat)
    return copy.reshape(frames.shape)


def blended(frames, place, share):
    def change(copy, flat):
        copy[place] = (1 - share) * flat[place] + share * flat[place - 1]

    return changed(frames, change)


def only(report):
    assert len(report.findings) == 1, [f.message for f in report.findings]
    return report.findings[0]


@settings(max_examples=12, deadline=None)
@given(
    noise_dn=st.floats(0.3, 5),
    modulation=st.floats(45, 105),
    gamma=st.sampled_from([1.0, 1.05, 1.2, 2.2]),
    counts=st.sampled_from([PAPER, COARSE_TO_FINE, (36, 35, 30), (64,)]),
    steps=st.sampled_from([4, 5, 8]),
    surface=st.sampled_from(["smooth", "stepped"]),
    dark=st.sampled_from([0.0, 0.5]),
    seed=st.integers(0, 1000),
)
def test_good_frames_raise_no_alarm(noise_dn, modulation, gamma, counts, steps, surface, dark, seed):
    frames = clean_frames(counts, steps, surface=surface, gamma=gamma, modulation=modulation, dark=dark)
    report = check_frames(recorded(frames, noise_dn, seed), counts)
    assert report.ok, [f.message for f in report.findings]
    # Rounded patterns and harmonics of a strong gamma leave a little that looks like noise.
    assert 0.85 * noise_dn < report.noise_dn < 1.15 * noise_dn + 0.6


@pytest.mark.parametrize("gamma", [1.0, 1.2])
def test_three_steps_rest_on_the_agreement_of_the_sets(gamma):
    frames = clean_frames(steps=3, gamma=gamma)
    assert check_frames(recorded(frames), PAPER).ok
    finding = only(check_frames(recorded(blended(frames, 5, 0.2)), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("blended", 1, 2)
    assert finding.magnitude == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(
    ("share", "place", "surface", "steps"),
    [
        (0.03, 1, "smooth", 4),
        (0.03, 4, "stepped", 4),
        (0.03, 10, "smooth", 8),
        (0.1, 10, "stepped", 4),
        (0.3, 8, "smooth", 8),
        (0.79, 4, "smooth", 4),
    ],
)
def test_a_blend_is_named_and_measured(share, place, surface, steps):
    frames = blended(clean_frames(steps=steps, surface=surface), place, share)
    finding = only(check_frames(recorded(frames), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("blended", *divmod(place, steps))
    assert finding.magnitude == pytest.approx(share, abs=0.008)
    assert finding.confidence > 0.95


def test_the_blend_of_a_published_measurement():
    """Physics notes, section 7, trap 13: frame = 0.79 previous + 0.21 expected, 33 DN rms in the redundancy."""
    frames = recorded(blended(clean_frames(), 6, 0.79))
    first = frames[1].astype(float)
    assert np.sqrt(np.mean(((first[0] + first[2] - first[1] - first[3]) / 2) ** 2)) > 20
    finding = only(check_frames(frames, PAPER))
    assert (finding.kind, finding.set, finding.step) == ("blended", 1, 2)
    assert finding.magnitude == pytest.approx(0.79, abs=0.01)
    assert finding.rms_dn > 40


@pytest.mark.parametrize(("counts", "place"), [(PAPER, 2), (PAPER, 4), (COARSE_TO_FINE, 11)])
def test_a_stale_frame(counts, place):
    finding = only(check_frames(recorded(blended(clean_frames(counts), place, 1.0)), counts))
    assert (finding.kind, finding.set, finding.step) == ("stale", *divmod(place, 4))
    assert finding.magnitude == pytest.approx(1.0, abs=0.03)


def test_what_the_first_frame_was_mixed_with_is_not_known():
    frames = clean_frames()
    frames[0, 0] = 0.6 * frames[0, 0] + 0.4 * np.random.default_rng(1).uniform(0, 160, SHAPE)
    finding = only(check_frames(recorded(frames), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("blended", 0, 0)
    assert finding.magnitude == pytest.approx(0.4, abs=0.03)


@pytest.mark.parametrize(("lost", "last"), [(0, "repeated"), (3, "black"), (6, "foreign"), (9, "repeated")])
def test_a_lost_frame_shifts_all_later_ones(lost, last):
    def change(copy, flat):
        copy[lost:-1] = flat[lost + 1 :]
        copy[-1] = {"repeated": flat[-1], "black": 0 * flat[0], "foreign": flat[1]}[last]

    finding = only(check_frames(recorded(changed(clean_frames(), change)), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("dropped", *divmod(lost, 4))


@pytest.mark.parametrize("extra", [1, 5, 8])
def test_a_frame_recorded_twice_shifts_all_later_ones(extra):
    def change(copy, flat):
        copy[extra:] = flat[extra - 1 : -1]

    finding = only(check_frames(recorded(changed(clean_frames(), change)), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("repeated", *divmod(extra, 4))


@pytest.mark.parametrize("pair", [(0, 2), (1, 2), (3, 4), (2, 9)])
def test_swapped_frames_also_where_a_set_stays_a_sinusoid(pair):
    def change(copy, flat):
        copy[list(pair)] = flat[list(pair[::-1])]

    finding = only(check_frames(recorded(changed(clean_frames(), change)), PAPER))
    assert finding.kind == "swapped"
    assert ((finding.set, finding.step), finding.other) == (divmod(pair[0], 4), divmod(pair[1], 4))
    assert finding.confidence > 0.95


@pytest.mark.parametrize("steps", [3, 4, 8])
def test_a_black_frame(steps):
    frames = clean_frames(steps=steps)
    frames[1, 2] = 3.0
    finding = only(check_frames(recorded(frames), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("black", 1, 2)


@pytest.mark.parametrize(("change", "counts"), [(-0.4, PAPER), (0.05, PAPER), (-0.4, (64,)), (-0.05, (64,))])
def test_a_change_of_brightness_is_no_blend(change, counts):
    frames = clean_frames(counts)
    frames[0, 2] *= 1 + change
    finding = only(check_frames(recorded(frames), counts))
    assert (finding.kind, finding.set, finding.step) == ("brightness", 0, 2)
    assert finding.magnitude == pytest.approx(change, abs=0.01)


def test_a_copy_of_another_frame():
    frames = clean_frames()
    frames[2, 1] = frames[0, 0]
    finding = only(check_frames(recorded(frames), PAPER))
    assert (finding.kind, finding.set, finding.step, finding.other) == ("duplicate", 2, 1, (0, 0))


@pytest.mark.parametrize(("places", "share"), [((2, 6), 1.0), ((5, 6), 0.2), ((2, 9), 0.05)])
def test_two_faults(places, share):
    frames = clean_frames()

    def change(copy, flat):
        for place in places:
            copy[place] = (1 - share) * flat[place] + share * flat[place - 1]

    report = check_frames(recorded(changed(frames, change)), PAPER)
    kind = "stale" if share == 1 else "blended"
    assert sorted((f.kind, 4 * f.set + f.step) for f in report.findings) == [(kind, p) for p in places]


def test_sets_out_of_order_contradict_each_other():
    finding = only(check_frames(recorded(clean_frames()[::-1]), PAPER))
    assert finding.kind == "inconsistent"


def test_saturation_names_each_frame_and_how_much_of_it():
    frames = recorded(clean_frames(modulation=60))
    frames[2, 1, :40] = 255
    finding = only(check_frames(frames, PAPER))
    assert (finding.kind, finding.set, finding.step) == ("saturated", 2, 1)
    assert finding.magnitude == pytest.approx(0.4, abs=0.02)


def test_ten_bits_in_sixteen_saturate_at_1023():
    frames = recorded(4 * clean_frames(), 4.0, dtype=np.uint16)
    assert check_frames(frames, PAPER).ok
    frames[0, 3, 50:90] = 1023
    assert only(check_frames(frames, PAPER)).kind == "saturated"
    assert check_frames(frames, PAPER, saturation_dn=4095).findings[0].kind != "saturated"


def test_too_little_modulation_of_one_set_and_of_all():
    frames = clean_frames()
    frames[1] = frames[1].mean(axis=0) + 0.04 * (frames[1] - frames[1].mean(axis=0))
    finding = only(check_frames(recorded(frames), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("low_modulation", 1, -1)
    finding = only(check_frames(recorded(clean_frames(modulation=4.0), 0.5), PAPER))
    assert (finding.kind, finding.set) == ("low_modulation", -1)
    report = check_frames(np.full((3, 4, 40, 50), 20, np.uint8), PAPER)
    assert only(report).kind == "low_modulation"
    assert report.lit_fraction == 0


def test_one_set_of_three_steps_says_that_nothing_can_be_checked():
    report = check_frames(recorded(clean_frames((64,), 3)), (64,))
    assert not report.within_sets_checked
    assert not report.between_sets_checked
    assert np.isnan(report.noise_dn)
    assert any("3 steps" in note for note in report.notes)
    assert any("one set" in note for note in report.notes)


@pytest.mark.parametrize("place", [1, 2, 3])
def test_one_set_of_four_steps_shows_blends(place):
    report = check_frames(recorded(blended(clean_frames((64,)), place, 0.05)), (64,))
    finding = only(report)
    assert (finding.kind, finding.step) == ("blended", place)
    assert finding.magnitude == pytest.approx(0.05, abs=0.01)


def test_float_frames_without_noise():
    frames = clean_frames().astype(np.float32)
    assert check_frames(frames, PAPER).ok
    finding = only(check_frames(blended(frames, 7, 0.05), PAPER))
    assert (finding.kind, finding.set, finding.step) == ("blended", 1, 3)


def test_a_finding_is_a_sentence():
    finding = only(check_frames(recorded(blended(clean_frames(), 6, 0.5)), PAPER))
    assert finding.message.startswith("set 1 step 2 holds 0.50")
    with pytest.raises(dataclasses.FrozenInstanceError):
        finding.set = 0


@pytest.mark.parametrize(
    ("frames", "counts", "error", "words"),
    [
        (np.zeros((4, 20, 20), np.uint8), PAPER, FramesError, "sets, steps, rows, columns"),
        (np.zeros((3, 2, 20, 20), np.uint8), PAPER, FramesError, "3 or more"),
        (np.zeros((3, 4, 20, 20)), PAPER, FramesError, "uint8, uint16 and float32"),
        (np.full((3, 4, 20, 20), np.nan, np.float32), PAPER, FramesError, "NaN"),
        (np.zeros((3, 4, 20, 20), np.uint8), (64, 63), CountsError, "2 fringe counts for 3 sets"),
        (np.zeros((3, 4, 20, 20), np.uint8), (64, 63, -1), CountsError, "positive"),
        ([[[[1], [1, 2]]]], PAPER, FramesError, "one array"),
        (np.ma.masked_equal(np.zeros((3, 4, 20, 20), np.uint8), 0), PAPER, FramesError, "drop the mask"),
    ],
)
def test_bad_input_is_one_clear_line(frames, counts, error, words):
    with pytest.raises(error, match=words):
        check_frames(frames, counts)


@pytest.mark.parametrize(
    "counts",
    [
        *["abc", None, 64, ("64", "63", "56"), ((64, 63), (56,), 1), (64, 63, 56j), (64, 63, True), (64, 63, np.nan)],
        *[{64: 0, 63: 0, 56: 0}, (10**7, 10**7 - 1, 56)],
    ],
)
def test_counts_that_are_none_are_refused(counts):
    with pytest.raises(CountsError, match=r"positive numbers .*at most 16384"):
        check_frames(recorded(clean_frames()), counts)


def test_thousands_of_fringes_are_compared_a_part_at_a_time(monkeypatch):
    frames = recorded(blended(clean_frames(), 6, 0.5))
    report = check_frames(frames, PAPER)
    monkeypatch.setattr("irpmd_rig.core.quality.model.ORDERS_AT_ONCE", 64 * 1000)
    assert check_frames(frames, PAPER) == report


@pytest.mark.parametrize(
    "name",
    ["saturation_dn", "min_modulation_dn", "max_saturated_fraction", "min_blend", "min_brightness_change"],
)
@pytest.mark.parametrize("bad", ["1", True, 1j, [1], np.nan, np.inf, -1])
def test_thresholds_that_are_no_numbers_are_refused(name, bad):
    with pytest.raises(MeasurementError, match=name):
        check_frames(np.zeros((3, 4, 20, 20), np.uint8), PAPER, **{name: bad})


@pytest.mark.parametrize("kind", ["uint16", "float32"])
def test_the_byte_order_does_not_matter(kind):
    frames = recorded(blended(clean_frames(), 6, 0.5), dtype=np.dtype(kind).type)
    swapped = frames.astype(frames.dtype.newbyteorder(">"))
    assert check_frames(swapped, PAPER) == check_frames(frames, PAPER)


def test_a_value_over_full_scale_is_refused():
    with pytest.raises(FramesError, match="over the full scale of 1023"):
        check_frames(np.full((3, 4, 20, 20), 2000, np.uint16), PAPER, saturation_dn=1023)
