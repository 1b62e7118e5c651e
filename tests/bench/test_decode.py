import numpy as np
import pytest

from irpmd_rig.bench.decode import COUNTS, noisy_frames, numpy_decode, run, trivial
from irpmd_rig.bench.timing import median_ms, slower
from irpmd_rig.core.phase import decode


@pytest.mark.parametrize("bits", [8, 10])
def test_the_baseline_gives_the_same_results_as_the_kernel(bits):
    frames = noisy_frames(256, bits)
    absolute = decode(frames, COUNTS)
    phase, modulation, valid = numpy_decode(frames, 2**bits - 1)
    inner = slice(8, -8)
    np.testing.assert_allclose(absolute.phase_rad[:, inner], phase[:, inner], atol=2e-4)
    np.testing.assert_allclose(absolute.modulation_dn, modulation, rtol=5e-5)
    np.testing.assert_array_equal(absolute.valid, valid)


def test_trivial_arithmetic_reads_every_frame_and_writes_every_map():
    frames = noisy_frames(32, 8)
    one, two, three = trivial(frames)
    np.testing.assert_array_equal(one, frames.sum(axis=(0, 1)))
    np.testing.assert_array_equal(two, one + 1)
    assert three.all()


def test_each_row_stands_beside_its_baseline():
    rows = run(size_px=64, repeats=2)
    assert [(row.name, row.sense, row.must, row.aim) for row in rows] == [
        ("decode", "at least", 12.0, 20.0),
        ("decode", "at most", None, 2.5),
        ("decode, maps of an earlier result reused", "at least", None, None),
        ("10-bit", "at least", 12.0, 18.0),
        ("10-bit", "at most", None, None),
        ("10-bit, maps of an earlier result reused", "at least", None, None),
    ]
    for row in rows:
        expected = row.baseline_value / row.value if row.sense == "at least" else row.value / row.baseline_value
        assert row.ratio == pytest.approx(expected)
        assert row.unit == "ms"


def test_candidates_run_in_turns_after_one_call_each():
    calls = []
    median_ms({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, repeats=2)
    assert calls == ["a", "b", "a", "b", "a", "b"]


def test_a_row_knows_whether_it_reaches_its_limits():
    row = slower("x", {"x": 3.0, "y": 2.0}, "y", must=None, aim=1.4)
    assert row.reaches(row.must)
    assert not row.reaches(row.aim)
