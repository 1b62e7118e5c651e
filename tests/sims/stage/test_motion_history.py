"""Where a carriage was at times that are over, and that it comes to rest."""

import pytest

from sims.clock import ManualClock
from sims.stage.motion import Axis, AxisSettings


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(5.0)


def test_the_past_is_remembered_through_moves_stops_and_homing(clock: ManualClock) -> None:
    axis = Axis(AxisSettings(), clock, 3)
    seen: list[tuple[float, float]] = []

    def look(seconds: float) -> None:
        for _ in range(10):
            clock.advance(seconds / 10)
            seen.append((clock.now(), axis.true_mm))

    axis.move_to(50.0)
    look(1.0)
    axis.move_to(10.0)
    look(4.0)
    axis.faults.lost_counts = 300
    axis.move_to(80.0)
    look(1.5)
    axis.stop()
    look(1.0)
    axis.home()
    look(10.0)
    for time_s, true_mm in seen:
        assert axis.true_mm_at(time_s) == pytest.approx(true_mm, abs=1e-12)
    # Before everything that is known it was where it began.
    assert axis.true_mm_at(0.0) == pytest.approx(0.0, abs=1e-12)


def test_a_carriage_rings_and_then_stands_still(clock: ManualClock) -> None:
    axis = Axis(AxisSettings(settle_s=0.2, ringing_um=20.0), clock, 1)
    axis.move_to(20.0)
    clock.advance(1.2 + 0.01)
    rest_mm = axis.true_mm_at(clock.now() + 100.0)
    assert abs(axis.true_mm - rest_mm) > 1e-3
    clock.advance(0.2)
    # Not nearly, exactly: who keeps what belongs to a position finds it again.
    assert {axis.true_mm_at(clock.now() + later_s) for later_s in (0.0, 0.013, 0.1, 7.0)} == {rest_mm}
