"""What a projector shows at a time, and when its sync edges fall."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sims.clock import Clock, ManualClock
from sims.projector.player import NOTHING, Light, Player, Programme, Shown, SyncOutput


class Grey:
    def __init__(self, value: int) -> None:
        self.value = value

    def image(self) -> np.ndarray:
        return np.full((2, 2), self.value, np.uint8)


def programme(start_s: float, count: int = 3, *, passes: int | None = 1, exposure_s: float = 0.008) -> Programme:
    patterns = tuple(Grey(k + 1) for k in range(count))
    return Programme(start_s, patterns, 0.01, exposure_s, 0.01 * count, passes, (True,) * count)


def lit(clock: ManualClock) -> Player:
    player = Player(clock, 1)
    player.light(Light(-1.0, {"infrared": 0.5}))
    player.set_output(0, SyncOutput(enabled=True))
    return player


def grey(shown: Shown) -> int | None:
    return None if shown.image is None else int(shown.image[0, 0])


def test_patterns_follow_each_other_with_darkness_between() -> None:
    player = lit(ManualClock())
    player.show(programme(1.0))
    times = (0.999, 1.0, 1.0079, 1.0081, 1.01, 1.02, 1.0279, 1.0281, 1.03)
    assert [grey(player.shown_at(t)) for t in times] == [None, 1, 1, None, 2, 3, 3, None, None]
    assert player.shown_at(1.009) == NOTHING
    assert player.shown_at(1.02)[1:] == ("infrared", 0.5)


def test_a_repeated_programme_goes_round_until_the_next_one() -> None:
    player = lit(ManualClock())
    player.show(programme(0.0, passes=None))
    player.show(Programme(1.005))
    assert [grey(player.shown_at(t)) for t in (0.0, 0.03, 0.99, 1.001, 1.006)] == [1, 1, 1, 2, None]


def test_what_was_shown_can_be_asked_later() -> None:
    player = lit(ManualClock())
    for k in range(100):
        player.show(Programme(float(k), (Grey(k),)))
        player.light(Light(k + 0.5, {"infrared": k / 100}))
    assert [grey(player.shown_at(k + 0.75)) for k in range(1, 100)] == list(range(1, 100))
    assert player.shown_at(50.25).level == pytest.approx(0.49)


def test_a_programme_that_has_not_begun_gives_way_to_an_earlier_one() -> None:
    player = lit(ManualClock())
    player.show(Programme(10.0, (Grey(1),)))
    player.show(Programme(5.0, (Grey(2),)))
    assert grey(player.shown_at(12.0)) == 2


def test_the_led_of_a_pattern_may_be_its_own() -> None:
    player = Player(ManualClock(), 1)
    player.light(Light(0.0, {"red": 0.2, "green": 0.4}))
    two = Programme(
        0.0, (Grey(1), Grey(2)), 1.0, 1.0, 2.0, None, leds=(frozenset({"green"}), frozenset({"red", "green"}))
    )
    player.show(two)
    assert player.shown_at(0.5)[1:] == ("green", 0.4)
    assert player.shown_at(1.5)[1:] == ("red+green", 0.4)


def test_an_exposure_over_several_patterns_is_cut_at_every_change() -> None:
    player = lit(ManualClock())
    player.show(programme(1.0))
    player.light(Light(1.005, {"infrared": 1.0}))
    cuts = player.intervals(0.995, 1.022)
    assert [pytest.approx(end) for _, end, _ in cuts] == [1.0, 1.005, 1.008, 1.01, 1.018, 1.02, 1.022]
    assert [grey(shown) for _, _, shown in cuts] == [None, 1, 1, None, 2, None, 3]
    assert [shown.level for _, _, shown in cuts] == [0.5, 0.5, 1.0, 0.0, 1.0, 0.0, 1.0]


def test_edges_come_with_their_delay_and_their_exact_time() -> None:
    clock = ManualClock()
    player = lit(clock)
    player.set_output(0, SyncOutput(enabled=True, delay_s=0.001))
    heard: list[tuple[float, float]] = []
    player.on_sync(lambda time_s: heard.append((time_s, clock.now())))
    player.show(programme(1.0, passes=2))
    clock.advance(10)
    assert [time_s for time_s, _ in heard] == pytest.approx([1.001, 1.011, 1.021, 1.031, 1.041, 1.051])
    assert all(time_s == now_s for time_s, now_s in heard)


def test_a_disabled_output_and_a_missed_edge_are_not_heard() -> None:
    clock = ManualClock()
    player = lit(clock)
    heard: list[float] = []
    player.on_sync(heard.append)
    player.set_output(0, SyncOutput(enabled=False))
    player.show(programme(1.0))
    clock.advance(1.5)
    assert heard == []
    player.set_output(0, SyncOutput(enabled=True))
    player.miss_sync(2)
    player.show(programme(2.0))
    clock.advance(1)
    assert heard == pytest.approx([2.02])


def test_a_stopped_programme_raises_no_further_edges() -> None:
    clock = ManualClock()
    player = lit(clock)
    heard: list[float] = []
    player.on_sync(heard.append)
    player.show(programme(1.0, passes=None))
    clock.advance(1.015)
    player.show(Programme(clock.now()))
    clock.advance(10)
    assert heard == pytest.approx([1.0, 1.01])


def test_a_listener_may_ask_the_projector_and_the_clock() -> None:
    clock = ManualClock()
    player = lit(clock)
    seen: list[int | None] = []
    player.on_sync(lambda time_s: seen.append(grey(player.shown_at(clock.now() + time_s * 0))))
    player.show(programme(1.0))
    clock.advance(2)
    assert seen == [1, 2, 3]


def test_on_a_fast_clock_no_edge_is_lost_and_none_comes_twice() -> None:
    clock = Clock(time_scale=50)
    player = Player(clock, 1)
    player.set_output(0, SyncOutput(enabled=True, delay_s=0.0003))
    heard: list[float] = []
    player.on_sync(heard.append)
    start_s = clock.now() + 1
    player.show(Programme(start_s, (Grey(1),) * 100, 0.002, 0.002, 0.2, 20, (True,) * 100))
    clock.sleep(8)
    player.close()
    clock.close()
    assert heard == pytest.approx([start_s + 0.0003 + k * 0.002 for k in range(2000)])


@given(
    start=st.floats(0, 1e5),
    period=st.floats(2e-4, 1.0),
    count=st.integers(1, 12),
    extra=st.floats(0, 0.1),
    share=st.floats(0.1, 1.0),
    passes=st.integers(1, 4),
    steps=st.lists(st.floats(1e-4, 3.0), max_size=12),
    delay=st.floats(0, 0.01),
)
def test_however_the_clock_is_moved_every_edge_is_heard_once_and_at_its_pattern(
    start: float,
    period: float,
    count: int,
    extra: float,
    share: float,
    passes: int,
    steps: list[float],
    delay: float,
) -> None:
    clock = ManualClock(start)
    player = lit(clock)
    player.set_output(0, SyncOutput(enabled=True, delay_s=delay))
    heard: list[float] = []
    player.on_sync(heard.append)
    pass_s = count * period + extra
    patterns = tuple(Grey(k + 1) for k in range(count))
    player.show(Programme(start + 1.0, patterns, period, share * period, pass_s, passes, (True,) * count))
    for step in steps:
        clock.advance(step)
    clock.advance(math.ceil(passes * pass_s) + 3.0)
    assert len(heard) == passes * count
    assert heard == sorted(heard)
    if delay == 0:
        assert [grey(player.shown_at(time_s)) for time_s in heard] == [
            k + 1 for _ in range(passes) for k in range(count)
        ]
