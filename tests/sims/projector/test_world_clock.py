"""The clocks of the simulated world."""

import threading
import time

import pytest

from sims.clock import Clock, ManualClock


def test_a_fast_clock_runs_by_its_scale() -> None:
    clock = Clock(time_scale=100)
    before_s = time.monotonic()
    start_s = clock.now()
    after_s = time.monotonic()
    clock.sleep(50)
    ended_s = time.monotonic()
    passed_s = clock.now() - start_s
    # Between what passed of ours before and after each look at it.
    assert (ended_s - after_s) * 100 <= passed_s + 1e-6
    assert passed_s - 1e-6 <= (time.monotonic() - before_s) * 100
    assert passed_s >= 50
    assert ended_s - before_s < 50


@pytest.mark.parametrize("scale", [0, -1, float("inf"), float("nan")])
def test_a_clock_cannot_stand_still_or_run_backwards(scale: float) -> None:
    with pytest.raises(ValueError, match="time_scale"):
        Clock(scale)


def test_calls_are_made_in_order_of_time_by_one_thread_that_ends_with_the_clock() -> None:
    threads = threading.active_count()
    clock = Clock(time_scale=10)
    heard: list[int] = []
    done = threading.Event()
    now_s = clock.now()
    clock.call_at(now_s + 0.6, done.set)
    for delay in (3, 1, 4, 2):
        clock.call_at(now_s + delay / 10, lambda delay=delay: heard.append(delay))
    clock.call_at(now_s + 0.35, lambda: heard.append(99)).cancel()
    assert done.wait(30)
    assert heard == [1, 2, 3, 4]
    assert threading.active_count() == threads + 1
    clock.close()
    assert threading.active_count() == threads
    assert not clock.call_at(0.0, done.clear).pending


def test_a_manual_clock_makes_its_calls_at_their_time() -> None:
    clock = ManualClock(10.0)
    heard: list[float] = []

    def again() -> None:
        heard.append(clock.now())
        if len(heard) < 3:
            clock.call_at(clock.now() + 1, again)

    clock.call_at(11.0, again)
    assert clock.now() == 10.0
    clock.sleep(1.5)
    assert (heard, clock.now()) == ([11.0], 11.5)
    clock.advance(10)
    assert (heard, clock.now()) == ([11.0, 12.0, 13.0], 21.5)
