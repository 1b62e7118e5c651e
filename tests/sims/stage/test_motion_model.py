"""The motion model: trapezoids, limits, backlash, noise, ringing, lost steps, and the faults of a move."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sims.clock import ManualClock
from sims.stage.motion import Axis, AxisSettings, trapezoid

IDEAL = AxisSettings(ringing_um=0, backlash_um=0, noise_um=0)


def moved(axis: Axis, clock: ManualClock, target_mm: float) -> float:
    axis.move_to(target_mm)
    clock.advance(60)
    return axis.true_mm


def test_a_long_move_ramps_up_runs_and_ramps_down() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.move_to(20.0)  # 20 mm/s at 100 mm/s2: 0.2 s and 2 mm a ramp, 16 mm in 0.8 s between
    clock.advance(0.2)
    assert axis.true_mm == pytest.approx(2.0)
    clock.advance(0.8)
    assert axis.true_mm == pytest.approx(18.0)
    assert axis.busy
    clock.advance(0.2001)
    assert axis.true_mm == pytest.approx(20.0)
    assert not axis.busy


def test_a_short_move_never_reaches_full_speed() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.move_to(1.0)
    clock.advance(0.1)
    assert axis.true_mm == pytest.approx(0.5)
    clock.advance(0.1)
    assert axis.true_mm == pytest.approx(1.0)


@given(
    distance=st.floats(1e-3, 400),
    speed=st.floats(0.1, 100),
    acceleration=st.floats(1, 1000),
    start=st.floats(0, 5),
)
def test_the_ramps_cover_the_distance_and_respect_the_speed(
    distance: float, speed: float, acceleration: float, start: float
) -> None:
    ramps = trapezoid(distance, speed, acceleration, start)
    covered = sum((ramp.start_mm_s + ramp.end_mm_s) / 2 * ramp.duration_s for ramp in ramps)
    assert covered == pytest.approx(distance)
    assert all(0 <= ramp.end_mm_s <= speed * (1 + 1e-12) and ramp.duration_s >= 0 for ramp in ramps)


def test_noise_is_drawn_once_a_move_from_the_seed() -> None:
    def rests(seed: int) -> list[float]:
        clock = ManualClock()
        axis = Axis(AxisSettings(ringing_um=0, backlash_um=0), clock, seed)
        return [moved(axis, clock, target) - target for target in np.arange(1.0, 101.0)]

    errors = rests(1)
    assert errors == rests(1)
    assert errors != rests(2)
    assert np.std(errors) * 1000 == pytest.approx(1.0, rel=0.25)


def test_a_carriage_at_rest_stays_where_it_is() -> None:
    clock = ManualClock()
    axis = Axis(AxisSettings(), clock, 3)
    resting = moved(axis, clock, 10.0)
    clock.advance(100)
    assert axis.true_mm == resting


def test_backlash_shows_when_the_direction_turns_round() -> None:
    clock = ManualClock()
    axis = Axis(AxisSettings(ringing_um=0, noise_um=0, backlash_um=5), clock)
    assert moved(axis, clock, 10.0) == pytest.approx(10.0)
    assert moved(axis, clock, 9.0) == pytest.approx(9.005)
    assert moved(axis, clock, 8.0) == pytest.approx(8.005)
    assert moved(axis, clock, 8.003) == pytest.approx(8.005)
    assert moved(axis, clock, 9.0) == pytest.approx(9.0)


def test_the_carriage_rings_after_a_stop_and_has_settled_after_the_settle_time() -> None:
    clock = ManualClock()
    axis = Axis(AxisSettings(noise_um=0, backlash_um=0, settle_s=0.2), clock)
    axis.move_to(20.0)
    clock.advance(1.2)
    swings = []
    for _ in range(20):
        clock.advance(0.01)
        swings.append(abs(axis.true_mm - 20.0))
    assert max(swings[:5]) > 0.005
    assert max(swings[-1:]) <= 0.0005
    clock.advance(1.0)
    assert axis.true_mm == pytest.approx(20.0, abs=1e-6)


def test_a_limit_switch_ends_a_move() -> None:
    clock = ManualClock()
    axis = Axis(AxisSettings(travel_mm=(-5.0, 30.0), ringing_um=0, noise_um=0), clock)
    assert moved(axis, clock, 31.0) == pytest.approx(30.0)
    assert axis.outcome == "limit"
    assert moved(axis, clock, 30.0) == pytest.approx(30.0)
    assert moved(axis, clock, -6.0) == pytest.approx(-5.0 + 0.005)
    assert axis.outcome == "limit"


def test_stopping_decelerates_or_ends_at_once() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.move_to(100.0)
    clock.advance(1.0)
    axis.stop()
    assert axis.busy
    clock.advance(0.3)
    assert axis.true_mm == pytest.approx(18.0 + 2.0)
    assert not axis.busy
    axis.move_to(100.0)
    clock.advance(1.0)
    axis.stop(at_once=True)
    assert not axis.busy
    assert axis.true_mm == pytest.approx(20.0 + 18.0)


def test_a_move_ordered_during_a_move_starts_where_the_carriage_is() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.move_to(100.0)
    clock.advance(1.0)
    assert moved(axis, clock, 10.0) == pytest.approx(10.0)


def test_a_stalled_move_is_busy_until_it_is_stopped() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.faults.stall_fraction = 0.25
    assert moved(axis, clock, 20.0) == pytest.approx(5.0)
    assert axis.busy
    axis.stop()
    clock.advance(0)
    assert not axis.busy
    assert moved(axis, clock, 20.0) == pytest.approx(20.0)


def test_lost_steps_stay_unknown_to_the_controller_until_homing() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.faults.lost_counts = 100
    assert moved(axis, clock, 20.0) == pytest.approx(19.9)
    assert axis.controller_mm == pytest.approx(20.0)
    assert moved(axis, clock, 30.0) == pytest.approx(29.9)
    axis.home()
    clock.advance(60)
    assert axis.true_mm == pytest.approx(0.0)
    assert axis.controller_mm == pytest.approx(0.0)


def test_an_overshoot_and_an_early_limit_are_known_to_the_controller() -> None:
    clock = ManualClock()
    axis = Axis(IDEAL, clock)
    axis.faults.overshoot_mm = 0.05
    assert moved(axis, clock, 20.0) == pytest.approx(20.05)
    assert axis.controller_mm == pytest.approx(20.05)
    axis.faults.limit_fraction = 0.5
    assert moved(axis, clock, 0.0) == pytest.approx(20.05 / 2)
    assert axis.outcome == "limit"


def test_an_axis_cannot_start_outside_its_travel() -> None:
    with pytest.raises(ValueError, match="within travel_mm"):
        Axis(AxisSettings(start_mm=-1.0), ManualClock())
