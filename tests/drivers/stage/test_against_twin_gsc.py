"""The driver on a simulated GSC controller: what it reads is what the controller has, every fault ends in its typed
error within its bound, and the next operation works once the fault is mended."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.errors import (
    DeviceLost,
    GarbledReply,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    Refused,
    TimedOut,
)
from drivers.stage.dialect import DIALECT_FOLDER
from drivers.stage.engine import SerialStage
from drivers.values import Position, StageCondition, StopAnswer
from sims.clock import Clock
from sims.stage import AxisSettings, Gsc, StageTwin

Build = Callable[..., SerialStage]

TIME_SCALE = 20.0
HOME_MM = 10.0
# Where the driver's zero is the twin's home, the true position is HOME_MM more; noise and backlash are a few um.
NEAR_MM = 0.012
ANSWER_S = 0.6
# What a busy machine may add; what hangs takes longer.
SLACK_S = 20.0
# At which it is on its way for seconds of ours, whenever the machine comes to disturb it.
SLOW_MM_PER_S = 4.0
BOTH = pytest.mark.parametrize("line", ["pty", "socket"])


@pytest.fixture
def line() -> str:
    return "pty"


@pytest.fixture
def twin(line: str, tmp_path: Path) -> Iterator[StageTwin]:
    axes = {1: AxisSettings(home_mm=HOME_MM, start_mm=HOME_MM, ringing_um=0.0)}
    link = tmp_path / "stage" if line == "pty" else None
    twin = StageTwin(axes, Gsc, Clock(TIME_SCALE), link=link, seed=1)
    twin.start()
    yield twin
    twin.close()


@pytest.fixture
def dialect(tmp_path: Path) -> str:
    """The shipped dialect, with a shorter bound for an answer."""
    path = tmp_path / "gsc.yaml"
    path.write_text((DIALECT_FOLDER / "gsc.yaml").read_text().replace("timeout_s: 1.0", f"timeout_s: {ANSWER_S}"))
    return str(path)


@pytest.fixture
def stage(twin: StageTwin, stage_on: Build, dialect: str) -> SerialStage:
    stage = stage_on(twin, dialect, limits_mm=(-20.0, 300.0), speed_mm_per_s=20.0, progress_timeout_s=0.3)
    stage.zero(0.0, confirmed_by="Ada")
    return stage


@contextmanager
def raised(error: type[InstrumentError], within_s: float, match: str | None = None) -> Iterator[None]:
    began_s = time.monotonic()
    with pytest.raises(error, match=match) as caught:
        yield
    assert time.monotonic() - began_s < within_s
    assert type(caught.value) is error
    assert caught.value.device == "stage1"
    assert caught.value.remedy


def works(stage: SerialStage, twin: StageTwin, position_mm: float = 30.0) -> None:
    """The stage goes where it is told, and stands where it says."""
    stage.move_to(position_mm)
    assert stage.wait(30.0) == Position(position_mm, measured=True)
    assert stage.state().condition == StageCondition.READY
    assert twin.position_mm() == pytest.approx(HOME_MM + position_mm, abs=NEAR_MM)


@BOTH
def test_it_homes_moves_and_stands_where_it_says(stage: SerialStage, twin: StageTwin) -> None:
    works(stage, twin)
    assert stage.home() == Position(0.0, measured=True)
    assert stage.position() == Position(0.0, measured=True)
    assert twin.position_mm() == pytest.approx(HOME_MM, abs=NEAR_MM)
    for target_mm in (25.0, 24.999, -5.5, 120.0):
        works(stage, twin, target_mm)
    assert stage.state().position == Position(120.0, measured=True)


def test_a_zero_is_where_the_person_says(stage: SerialStage, twin: StageTwin) -> None:
    works(stage, twin, 12.0)
    assert stage.zero(100.0, confirmed_by="Ada") == Position(100.0, measured=True)
    stage.move_to(103.0)
    assert stage.wait() == Position(103.0, measured=True)
    assert twin.position_mm() == pytest.approx(HOME_MM + 15.0, abs=NEAR_MM)


def test_a_stage_whose_counts_run_the_other_way(tmp_path: Path, stage_on: Build) -> None:
    axis = AxisSettings(counts_per_mm=500.0, direction=-1, start_mm=100.0)
    twin = StageTwin({1: axis}, Gsc, Clock(TIME_SCALE), link=tmp_path / "stage", seed=1)
    twin.start()
    try:
        stage = stage_on(twin, "gsc", counts_per_mm=500.0, sign=-1, limits_mm=(0.0, 200.0), home_position_mm=3.0)
        assert stage.home() == Position(3.0, measured=True)
        stage.move_to(7.5)
        assert stage.wait() == Position(7.5, measured=True)
        assert twin.position_mm() == pytest.approx(4.5, abs=NEAR_MM)
    finally:
        twin.close()


def test_speeds_are_kept(stage: SerialStage, twin: StageTwin) -> None:
    took_s = []
    for speed_mm_per_s in (20.0, 5.0):
        assert stage.set_speed(speed_mm_per_s) == speed_mm_per_s
        began_s = time.monotonic()
        works(stage, twin, 40.0 if speed_mm_per_s > 10 else 0.0)
        took_s.append(TIME_SCALE * (time.monotonic() - began_s))
    # At 20 and at 5 mm/s, in the twin's seconds; the driver looks every 0.03 s.
    assert took_s[0] >= 2.0
    assert took_s[1] >= 8.0


def test_soft_limits_let_nothing_move(stage: SerialStage, twin: StageTwin) -> None:
    for target_mm in (-20.1, 300.5):
        with raised(LimitReached, SLACK_S, "soft limits"):
            stage.move_to(target_mm)
    assert not twin.moving()
    works(stage, twin)


def test_the_end_of_travel_is_a_limit_switch(stage: SerialStage, twin: StageTwin) -> None:
    stage.move_to(-15.0)  # 5 mm beyond the switch, and inside the soft limits
    with raised(LimitReached, SLACK_S, r"-10\.000 mm"):
        stage.wait()
    assert stage.state().condition == StageCondition.AT_LIMIT
    works(stage, twin)


def test_a_limit_on_the_way_is_told_and_left_again(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.limit_next_move(fraction=0.5)
    stage.move_to(20.0)
    with raised(LimitReached, SLACK_S, r"10\.000 mm"):
        stage.wait()
    works(stage, twin)


def test_a_stall_is_stopped(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.stall_next_move(fraction=0.25)
    stage.move_to(40.0)
    with raised(MotionFailed, SLACK_S, r"no progress for 0\.3 s at 10\.000 mm"):
        stage.wait()
    assert not twin.moving()
    assert stage.state().condition == StageCondition.FAILED
    with raised(MotionFailed, SLACK_S, "no progress"):
        stage.wait()
    works(stage, twin)


def test_an_overshoot_is_no_arrival(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.overshoot_next_move(by_mm=0.05)
    stage.move_to(20.0)
    with raised(MotionFailed, SLACK_S, r"\+0\.0500 mm from its target"):
        stage.wait()
    assert stage.position() == Position(20.05, measured=True)
    works(stage, twin)


def test_homing_ends_at_the_sensor_or_fails(stage: SerialStage, twin: StageTwin) -> None:
    works(stage, twin, 40.0)
    twin.faults.overshoot_next_move(by_mm=0.5)
    assert stage.home() == Position(0.0, measured=True)
    assert twin.position_mm() == pytest.approx(HOME_MM, abs=NEAR_MM)
    stage.move_to(20.0)
    with raised(MotionFailed, SLACK_S, r"\+0\.5000 mm"):
        stage.wait()
    twin.faults.stall_next_move(fraction=0.5)
    with raised(MotionFailed, SLACK_S, r"no progress for 0\.3 s at 10250 counts"):
        stage.home()
    assert not twin.moving()
    with raised(Refused, SLACK_S, "no zero"):
        stage.move_to(1.0)
    twin.faults.limit_next_move(fraction=0.5)
    with raised(MotionFailed, SLACK_S, "homing ended at"):
        stage.home()
    stage.home()
    works(stage, twin)


def test_lost_steps_are_seen_by_nobody_until_it_homes(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.lose_steps(counts=200.0)
    stage.move_to(20.0)
    # The controller counts what it sent: the driver can know no better.
    assert stage.wait() == Position(20.0, measured=True)
    assert twin.position_mm() == pytest.approx(HOME_MM + 19.8, abs=NEAR_MM)
    assert stage.home() == Position(0.0, measured=True)
    works(stage, twin)


@BOTH
def test_unplugged_during_a_move(stage: SerialStage, twin: StageTwin) -> None:
    stage.set_speed(SLOW_MM_PER_S)
    stage.move_to(200.0)
    threading.Timer(0.1, twin.faults.unplug).start()
    with raised(DeviceLost, SLACK_S, "is gone"):
        stage.wait()
    state = stage.state()
    assert (state.condition, state.position) == (StageCondition.LOST, None)
    with raised(DeviceLost, SLACK_S):
        stage.wait()
    twin.faults.replug()
    with raised(Refused, SLACK_S, "no zero"):
        stage.move_to(10.0)
    # What was still moving was ended as soon as the controller was found again.
    assert not twin.moving()
    stage.set_speed(20.0)
    stage.home()
    works(stage, twin)


def test_unplugged_at_rest_and_plugged_in_while_somebody_waits(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.unplug()
    threading.Timer(0.4, twin.faults.replug).start()
    with pytest.raises((DeviceLost, Refused)):  # the first answer may only tell that the line is gone
        stage.position()
    assert stage.home() == Position(0.0, measured=True)
    works(stage, twin)


def test_gone_for_good_is_lost_within_the_time_to_reconnect(twin: StageTwin, stage_on: Build, dialect: str) -> None:
    stage = stage_on(twin, dialect, reconnect_s=0.3)
    twin.faults.unplug()
    for _ in range(3):
        with raised(DeviceLost, 0.3 + SLACK_S):
            stage.home()
    twin.faults.replug()
    time.sleep(0.3)
    stage.home()
    works(stage, twin)


def test_a_mute_controller_is_a_time_out(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.line.mute = True
    with raised(TimedOut, ANSWER_S + SLACK_S, "no answer"):
        stage.move_to(20.0)
    assert not twin.moving()
    twin.faults.line.clear()
    works(stage, twin)


def test_a_controller_that_falls_mute_during_a_move(stage: SerialStage, twin: StageTwin) -> None:
    stage.move_to(100.0)
    twin.faults.line.mute = True
    with raised(TimedOut, ANSWER_S + SLACK_S, "no answer"):
        stage.wait()
    twin.faults.line.clear()
    # Nobody has called it done: it can be waited for again.
    assert stage.wait() == Position(100.0, measured=True)
    works(stage, twin)


@pytest.mark.parametrize(("fault", "error"), [("garble_next", GarbledReply), ("cut_next", TimedOut)])
def test_a_bad_answer(stage: SerialStage, twin: StageTwin, fault: str, error: type[InstrumentError]) -> None:
    getattr(twin.faults.line, fault)()
    with pytest.raises(InstrumentError) as caught:
        stage.position()
    # A garbled end of line is no end of line: then nothing but the bound tells.
    assert type(caught.value) in (error, TimedOut)
    assert stage.position() == Position(0.0, measured=True)
    works(stage, twin)


def test_slow_answers_are_waited_for_and_too_slow_ones_never_taken_for_the_next(
    stage: SerialStage, twin: StageTwin
) -> None:
    twin.faults.line.slow_s = 0.1 * TIME_SCALE
    works(stage, twin, 10.0)
    twin.faults.line.slow_s = 1.6 * ANSWER_S * TIME_SCALE
    with raised(TimedOut, ANSWER_S + SLACK_S, "no answer"):
        stage.position()
    twin.faults.line.clear()
    # The late answer to the question above comes now; the controller says OK to the next one.
    works(stage, twin)


def test_stop_does_not_wait_for_a_late_answer_and_does_not_believe_it(stage: SerialStage, twin: StageTwin) -> None:
    stage.move_to(280.0)
    # It comes when the next question may have been asked.
    twin.faults.line.slow_s = 1.3 * ANSWER_S * TIME_SCALE
    with raised(TimedOut, ANSWER_S + SLACK_S):
        stage.wait()
    twin.faults.line.clear()
    assert stage.stop() == StopAnswer(stopped=True)
    assert not twin.moving()
    works(stage, twin)


@BOTH
def test_endless_answers(stage: SerialStage, twin: StageTwin) -> None:
    twin.faults.line.endless = True
    with raised(GarbledReply, ANSWER_S + SLACK_S):
        stage.position()
    with raised(GarbledReply, ANSWER_S + SLACK_S):
        stage.move_to(1.0)
    twin.faults.line.clear()
    works(stage, twin)


def test_stop_from_another_thread(stage: SerialStage, twin: StageTwin) -> None:
    stage.set_speed(SLOW_MM_PER_S)
    stage.move_to(280.0)
    answers: list[StopAnswer] = []
    threading.Timer(0.2, lambda: answers.append(stage.stop())).start()
    with raised(MotionFailed, SLACK_S, "stopped"):
        stage.wait()
    end_s = time.monotonic() + SLACK_S
    while not answers:
        assert time.monotonic() < end_s
        time.sleep(0.01)
    assert answers == [StopAnswer(stopped=True)]
    assert not twin.moving()
    assert twin.position_mm() < 250.0
    stage.set_speed(20.0)
    works(stage, twin)


def test_stop_of_homing_leaves_no_zero(stage: SerialStage, twin: StageTwin) -> None:
    works(stage, twin, 250.0)
    stage.set_speed(SLOW_MM_PER_S)
    threading.Timer(0.1, stage.stop).start()
    with raised(MotionFailed, SLACK_S, "stopped"):
        stage.home()
    with raised(Refused, SLACK_S, "no zero"):
        stage.move_to(1.0)
    stage.set_speed(20.0)
    stage.home()
    works(stage, twin)


def test_close_ends_the_motion(stage: SerialStage, twin: StageTwin) -> None:
    stage.move_to(280.0)
    began_s = time.monotonic()
    stage.close()
    assert time.monotonic() - began_s < SLACK_S
    assert not twin.moving()
    stage.open()
    stage.home()
    works(stage, twin)


@pytest.mark.parametrize("heard", ["silent", "garbage"])
def test_a_wrong_baud_rate(tmp_path: Path, stage_on: Build, dialect: str, heard: str) -> None:
    twin = StageTwin({1: AxisSettings()}, Gsc, Clock(TIME_SCALE), link=tmp_path / "stage", wrong_line=heard)
    twin.start()
    try:
        wrong = stage_on(twin, dialect, opened=False, line={"baud": 19200})
        with raised(NotConnected, ANSWER_S + SLACK_S, "no answer"):
            wrong.open()
        stage = stage_on(twin, "gsc")
        assert stage.home() == Position(0.0, measured=True)
    finally:
        twin.close()
