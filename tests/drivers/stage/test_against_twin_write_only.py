"""The driver on simulated controllers that never answer: the stage goes where it is told, what nobody can measure is
never called measured, and after a loss nothing moves before somebody gave a zero again."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceLost, LimitReached, MotionFailed, Refused, Unsupported
from drivers.stage.engine import SerialStage
from drivers.values import Position, StageCondition
from sims.clock import Clock
from sims.stage import AxisSettings, Gcd0301m, Gcd040101m, StageTwin
from tests.small_world import until

Build = Callable[..., SerialStage]
Quick = Callable[..., str]

TIME_SCALE = 20.0
PAUSE_S = 0.05
# The twin is a thread, which a busy machine may hold up: it begins that much later than the driver has to believe.
SETTLE_S = 0.5
START_MM = 50.0
NEAR_MM = 0.012
AXIS = AxisSettings(start_mm=START_MM, ringing_um=0.0, acceleration_mm_s2=200.0)


@dataclass(frozen=True)
class Box:
    """A controller, and what a lab would have found out about it."""

    dialect: str
    firmware: Any
    codes: tuple[tuple[int, float], ...]
    more: Mapping[str, Any]


def facts(box: Box, time_scale: float = TIME_SCALE) -> dict[str, Any]:
    """What a lab would have measured of a box whose clock runs that much faster than the lab's."""
    speeds = [{"code": code, "speed_mm_per_s": time_scale * speed} for code, speed in box.codes]
    return {
        "speeds": {"kind": "table", "speeds": speeds},
        "speed_mm_per_s": time_scale * 20.0,
        "ramp_s": 0.2 / time_scale,
        "settle_s": SETTLE_S,
        "accept_no_stop": True,
        **box.more,
    }


BOXES = (
    Box("gcd-0301m", Gcd0301m, ((0xEF, 20.0), (0x5F, 20.0 * 0x5F / 0xEF)), {}),
    Box("gcd-040101m", Gcd040101m, ((5, 20.0), (2, 8.0)), {"byte_order": "little"}),
)


@pytest.fixture(params=BOXES, ids=lambda box: box.dialect)
def box(request: pytest.FixtureRequest) -> Box:
    return request.param


@pytest.fixture
def twin_of(tmp_path: Path) -> Iterator[Callable[..., StageTwin]]:
    twins: list[StageTwin] = []

    def start(
        firmware: Any, *, axes: int = 1, by_socket: bool = False, time_scale: float = TIME_SCALE, strict: bool = False
    ) -> StageTwin:
        # Two frames that a held-up thread reads at once are lost to it where it is strict: see the shipped pace.
        firmware = firmware if strict else partial(firmware, shortest_gap_s=0.0)
        link = None if by_socket else tmp_path / f"stage{len(twins)}"
        settings = dict.fromkeys(range(1, axes + 1), AXIS)
        twins.append(StageTwin(settings, firmware, Clock(time_scale), link=link, seed=1))
        twins[-1].start()
        return twins[-1]

    yield start
    for twin in twins:
        twin.close()


@pytest.fixture
def twin(box: Box, twin_of: Callable[..., StageTwin]) -> StageTwin:
    return twin_of(box.firmware)


@pytest.fixture
def stage(box: Box, twin: StageTwin, stage_on: Build, quick: Quick) -> SerialStage:
    stage = stage_on(twin, quick(box.dialect, PAUSE_S), **facts(box))
    stage.zero(0.0, confirmed_by="Ada")
    return stage


def works(stage: SerialStage, twin: StageTwin, position_mm: float, zero_mm: float = START_MM, axis: int = 1) -> None:
    """The stage goes where it is told, and nobody says that it was seen there."""
    stage.move_to(position_mm)
    assert stage.wait(30.0) == Position(position_mm, measured=False)
    assert stage.state().condition == StageCondition.READY
    assert not twin.moving(axis)
    assert twin.position_mm(axis) == pytest.approx(zero_mm + position_mm, abs=NEAR_MM)


def test_moves_both_ways_at_both_speeds(stage: SerialStage, twin: StageTwin) -> None:
    for target_mm in (1.0, 6.543, -2.0):
        works(stage, twin, target_mm)
    assert stage.set_speed(8.0 * TIME_SCALE) == pytest.approx(8.0 * TIME_SCALE, rel=0.01)
    works(stage, twin, 0.0)


def test_by_a_socket(box: Box, twin_of: Callable[..., StageTwin], stage_on: Build, quick: Quick) -> None:
    twin = twin_of(box.firmware, by_socket=True)
    stage = stage_on(twin, quick(box.dialect, PAUSE_S), **facts(box))
    stage.zero(0.0, confirmed_by="Ada")
    works(stage, twin, 2.0)
    twin.faults.unplug()
    with pytest.raises(DeviceLost):
        stage.position()
    twin.faults.replug()
    time.sleep(0.2)
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(0.0)
    stage.zero(2.0, confirmed_by="Ada")
    works(stage, twin, 1.0)


def test_two_axes_on_one_port(box: Box, twin_of: Callable[..., StageTwin], stage_on: Build, quick: Quick) -> None:
    twin = twin_of(box.firmware, axes=2)
    stages = [
        stage_on(
            twin,
            quick(box.dialect, PAUSE_S),
            name=f"stage{axis}",
            axis=axis,
            go_starts_all_axes=False,
            reconnect_s=0.2,
            **facts(box),
        )
        for axis in (1, 2)
    ]

    def move(stage: SerialStage, sign: int) -> None:
        stage.zero(0.0, confirmed_by="Ada")
        stage.move_to(sign)
        stage.wait()

    movers = [threading.Thread(target=move, args=pair) for pair in zip(stages, (1, -1), strict=True)]
    for mover in movers:
        mover.start()
    for mover in movers:
        mover.join()
    assert [twin.position_mm(axis) for axis in (1, 2)] == pytest.approx([START_MM + 1, START_MM - 1], abs=NEAR_MM)
    twin.faults.unplug()
    for stage in stages:
        with pytest.raises(DeviceLost) as caught:
            stage.position()
        assert caught.value.device == stage.name
    twin.faults.replug()
    time.sleep(0.2)
    for axis, stage in enumerate(stages, 1):
        stage.zero(0.0, confirmed_by="Ada")
        works(stage, twin, 1.0, twin.position_mm(axis), axis)


def test_unplugged_during_a_move(box: Box, twin_of: Callable[..., StageTwin], stage_on: Build, quick: Quick) -> None:
    # On a slow clock: it is on its way whenever the machine comes to unplug it.
    twin = twin_of(box.firmware, time_scale=2.0)
    stage = stage_on(twin, quick(box.dialect, PAUSE_S), **facts(box, 2.0))
    stage.zero(0.0, confirmed_by="Ada")
    stage.move_to(48.0)
    threading.Timer(0.1, twin.faults.unplug).start()
    began_s = time.monotonic()
    with pytest.raises(DeviceLost):
        stage.wait()
    assert time.monotonic() - began_s < 20.0
    assert (stage.state().condition, stage.state().position) == (StageCondition.LOST, None)
    twin.faults.replug()
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    until(lambda: not twin.moving())  # it runs to its target: no word of the driver's reaches it
    time.sleep(stage.stop().ends_in_s)
    stage.zero(48.0, confirmed_by="Ada")
    works(stage, twin, 47.0)


def test_what_nobody_can_see_is_never_called_measured(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.lose_steps(counts=300.0)
    stage.move_to(2.0)
    assert stage.wait() == Position(2.0, measured=False)
    assert twin.position_mm() == pytest.approx(START_MM + 1.7, abs=NEAR_MM)
    twin.faults.overshoot_next_move(by_mm=0.4)
    stage.move_to(1.0)
    assert stage.wait() == Position(1.0, measured=False)
    assert stage.position().measured is False
    # Whoever looks can say where it stands.
    stands_mm = twin.position_mm()
    stage.zero(1.0, confirmed_by="Ada")
    works(stage, twin, 3.0, stands_mm - 1.0)


def test_soft_limits_are_all_that_keeps_it_from_the_end(stage: SerialStage, twin: StageTwin) -> None:
    with pytest.raises(LimitReached, match="soft limits"):
        stage.move_to(50.1)
    with pytest.raises(Unsupported):
        stage.home()
    works(stage, twin, 1.0)


def test_a_wrong_baud_rate_moves_nothing_and_claims_nothing(
    box: Box, twin_of: Callable[..., StageTwin], stage_on: Build, quick: Quick
) -> None:
    twin = twin_of(box.firmware)
    wrong = stage_on(twin, quick(box.dialect, PAUSE_S), line={"baud": 38400}, **facts(box))
    wrong.zero(0.0, confirmed_by="Ada")
    wrong.move_to(1.0)
    assert wrong.wait() == Position(1.0, measured=False)
    assert twin.position_mm() == START_MM
    wrong.close()
    stage = stage_on(twin, quick(box.dialect, PAUSE_S), name="stage2", **facts(box))
    stage.zero(0.0, confirmed_by="Ada")
    works(stage, twin, 1.0)


def test_stop_before_the_start_cancels_it_for_the_stage_too(box: Box, twin: StageTwin, stage_on: Build) -> None:
    stage = stage_on(twin, box.dialect, **facts(box))  # the shipped pace: time enough to stop between the frames
    stage.zero(0.0, confirmed_by="Ada")
    threading.Timer(0.15, stage.stop).start()
    with pytest.raises(MotionFailed, match="before the move began"):
        stage.move_to(20.0)
    time.sleep(0.1)
    assert not twin.moving()
    assert twin.position_mm() == START_MM


def test_the_shipped_pace_is_one_that_the_boxes_follow(twin_of: Callable[..., StageTwin], stage_on: Build) -> None:
    """In real time, both at once."""
    twins = [twin_of(box.firmware, time_scale=1.0, strict=True) for box in BOXES]
    stages = [
        stage_on(twin, box.dialect, name=box.dialect, **facts(box, 1.0)) for twin, box in zip(twins, BOXES, strict=True)
    ]
    for stage in stages:
        stage.zero(0.0, confirmed_by="Ada")
    movers = [threading.Thread(target=stage.move_to, args=(10.0,)) for stage in stages]
    for mover in movers:
        mover.start()
    for mover in movers:
        mover.join()
    for stage, twin in zip(stages, twins, strict=True):
        assert stage.wait() == Position(10.0, measured=False)
        assert twin.position_mm() == pytest.approx(START_MM + 10.0, abs=NEAR_MM)
