"""The xiQ's times: what its manual says, and what must hold for any sequence of exposures."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sims.camera.timing import Schedule, SensorTiming

XIQ = SensorTiming()
LINES = 2048


def test_full_frames_take_the_manuals_time() -> None:
    assert XIQ.readout_s(2048) == pytest.approx(11_072.5e-6, abs=1e-12)
    assert 1 / XIQ.shortest_period_s(1e-3, 2048) == pytest.approx(90.3, abs=0.05)


def test_short_exposures_free_run_at_the_readouts_pace() -> None:
    schedule = Schedule(XIQ)
    starts = [schedule.free_running(0.0, 1e-3, LINES, 0.0).start_s for _ in range(5)]
    assert [later - earlier for earlier, later in pairwise(starts)] == pytest.approx([11_072.5e-6] * 4)


def test_long_exposures_free_run_at_their_own_pace() -> None:
    schedule = Schedule(XIQ)
    first, second = (schedule.free_running(0.0, 0.05, LINES, 0.0) for _ in range(2))
    assert second.start_s - first.start_s == pytest.approx(0.05 + 64.5e-6)


def test_a_frame_rate_is_kept_to() -> None:
    schedule = Schedule(XIQ)
    first, second = (schedule.free_running(0.0, 1e-3, LINES, 1 / 30) for _ in range(2))
    assert second.start_s - first.start_s == pytest.approx(1 / 30)


def test_a_camera_that_falls_behind_goes_on_from_now() -> None:
    schedule = Schedule(XIQ)
    schedule.free_running(0.0, 1e-3, LINES, 0.0)
    assert schedule.free_running(10.0, 1e-3, LINES, 0.0).start_s == 10.0


def test_exposure_begins_ten_microseconds_after_its_trigger_and_is_delivered_after_its_readout() -> None:
    exposure = Schedule(XIQ).trigger(2.0, 4e-3, LINES)
    assert exposure is not None
    assert exposure.start_s == pytest.approx(2.00001, abs=1e-9)
    assert exposure.delivered_s == pytest.approx(2.00001 + 4e-3 + 11_072.5e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("delay_s", "seen"),
    [
        (3.9e-3, False),  # during the exposure
        (4.05e-3, False),  # exposure over, but its successor's readout would have to wait
        (11.0e-3, False),
        (11.0725e-3, True),  # the shortest period
        (20e-3, True),
    ],
)
def test_a_trigger_that_comes_too_early_is_missed(delay_s: float, seen: bool) -> None:
    schedule = Schedule(XIQ)
    schedule.trigger(0.0, 4e-3, LINES)
    assert (schedule.trigger(delay_s, 4e-3, LINES) is not None) is seen


@given(st.lists(st.tuples(st.floats(0, 0.05), st.floats(1e-5, 0.05), st.integers(16, 2048)), min_size=2, max_size=20))
def test_no_two_exposures_and_no_two_readouts_overlap(steps: list[tuple[float, float, int]]) -> None:
    schedule = Schedule(XIQ)
    time_s, taken = 0.0, []
    for wait_s, exposure_s, lines in steps:
        time_s += wait_s
        exposure = schedule.trigger(time_s, exposure_s, lines)
        if exposure is not None:
            taken.append((exposure, XIQ.readout_s(lines)))
    assert taken
    for (earlier, _), (later, readout_s) in pairwise(taken):
        assert later.start_s >= earlier.start_s + earlier.exposure_s - 2e-9
        assert later.delivered_s - readout_s >= earlier.delivered_s - 2e-9
