"""A stage with read-back: what is told is measured, and nothing but an arrival is success."""

import threading
import time
from collections.abc import Callable

import pytest
from stage_peers import Gsc, Peer

from drivers.errors import (
    GarbledReply,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    Refused,
    TimedOut,
)
from drivers.stage.engine import SerialStage
from drivers.values import Position, StageCondition, StopAnswer
from tests.small_world import until

Build = Callable[..., SerialStage]
PeerAt = Callable[..., Peer]

# Bounds of a second or less have ended by then on any machine; what hangs has not.
HANG_S = 30.0


@pytest.fixture
def peer(peer_at: PeerAt, gsc: Gsc) -> Peer:
    return peer_at(gsc)


@pytest.fixture
def stage(peer: Peer, stage_on: Build) -> SerialStage:
    return stage_on(peer, "gsc")


def test_homes_and_moves_in_mm(stage: SerialStage, peer: Peer) -> None:
    assert stage.home() == Position(0.0, measured=True)
    stage.move_to(1.5)
    assert stage.wait() == Position(1.5, measured=True)
    stage.move_to(-0.25)
    assert stage.wait() == Position(-0.25, measured=True)
    commands = [frame for frame in peer.heard if frame not in (b"Q:\r\n", b"!:\r\n")]
    assert commands == [
        b"D:1S500F10000R200\r\n",
        # It stands there already: a short way and back proves that it homes.
        b"H:1\r\n",
        b"A:1+P500\r\n",
        b"G:\r\n",
        b"H:1\r\n",
        b"A:1+P1500\r\n",
        b"G:\r\n",
        b"A:1-P250\r\n",
        b"G:\r\n",
    ]


def test_sign_and_home_position_are_the_axis_s_own(peer: Peer, stage_on: Build) -> None:
    stage = stage_on(peer, "gsc", sign=-1, home_position_mm=10.0, counts_per_mm=100.0)
    assert stage.home() == Position(10.0, measured=True)
    stage.move_to(12.0)
    assert stage.wait().position_mm == pytest.approx(12.0)
    assert b"A:1-P200\r\n" in peer.heard


def test_an_absolute_move_needs_a_zero_first(stage: SerialStage, peer: Peer) -> None:
    assert stage.state().condition == StageCondition.NO_ZERO
    assert stage.state().position is None
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    with pytest.raises(Refused, match="no zero"):
        stage.position()
    assert b"G:\r\n" not in peer.heard


def test_a_zero_is_a_person_s_word_within_the_limits(stage: SerialStage, peer: Peer) -> None:
    with pytest.raises(Refused, match="nobody confirms"):
        stage.zero(5.0, confirmed_by=" ")
    with pytest.raises(LimitReached):
        stage.zero(51.0, confirmed_by="Ada")
    assert stage.zero(5.0, confirmed_by="Ada") == Position(5.0, measured=True)
    assert b"R:1\r\n" in peer.heard
    stage.move_to(5.5)
    assert stage.wait() == Position(5.5, measured=True)
    assert b"A:1+P500\r\n" in peer.heard


@pytest.mark.parametrize("position_mm", [50.001, -1e9, float("nan"), float("inf")])
def test_nothing_is_sent_for_a_target_outside_the_soft_limits(
    stage: SerialStage, peer: Peer, position_mm: float
) -> None:
    stage.home()
    before = len(peer.heard)
    with pytest.raises((LimitReached, Refused)):
        stage.move_to(position_mm)
    assert len(peer.heard) == before


def test_a_limit_switch_ends_the_move_and_the_stage_can_leave_it(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.limit_at = 2000
    stage.move_to(10.0)
    with pytest.raises(LimitReached, match=r"2\.000 mm"):
        stage.wait()
    assert stage.state().condition == StageCondition.AT_LIMIT
    with pytest.raises(LimitReached):
        stage.wait()
    stage.move_to(1.0)
    assert stage.wait().position_mm == 1.0
    assert stage.state().condition == StageCondition.READY


def test_a_stall_is_noticed_by_missing_progress_and_stopped(peer: Peer, stage_on: Build, gsc: Gsc) -> None:
    stage = stage_on(peer, "gsc", progress_timeout_s=0.3)
    stage.home()
    gsc.stalls_at = 3000
    stage.move_to(10.0)
    began_s = time.monotonic()
    with pytest.raises(MotionFailed, match="no progress"):
        stage.wait()
    assert time.monotonic() - began_s < HANG_S
    assert b"L:E\r\n" in peer.heard
    assert stage.state().condition == StageCondition.FAILED
    gsc.stalls_at = None
    stage.move_to(4.0)
    assert stage.wait().position_mm == 4.0


@pytest.mark.parametrize("by", [-20, 20])
def test_a_move_that_ends_outside_the_window_has_failed(stage: SerialStage, gsc: Gsc, by: int) -> None:
    stage.home()
    gsc.overshoots_by = by
    stage.move_to(10.0)
    with pytest.raises(MotionFailed, match="from its target"):
        stage.wait()


def test_a_move_that_ends_inside_the_window_has_succeeded_where_it_is(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.overshoots_by = 7
    stage.move_to(10.0)
    assert stage.wait() == Position(10.007, measured=True)


def test_a_time_out_is_not_done_and_the_move_can_be_waited_for_again(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.counts_per_s = 5_000
    stage.move_to(10.0)
    with pytest.raises(TimedOut, match="still moving"):
        stage.wait(0.1)
    assert stage.state().condition == StageCondition.MOVING
    assert 0.0 < stage.position().position_mm < 10.0
    with pytest.raises(Refused, match="still moves"):
        stage.move_to(0.0)
    assert stage.wait().position_mm == 10.0


def test_stop_ends_a_move_from_another_thread(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.counts_per_s = 5_000
    stage.move_to(40.0)
    answers: list[StopAnswer] = []
    timer = threading.Timer(0.2, lambda: answers.append(stage.stop()))
    timer.start()
    with pytest.raises(MotionFailed, match="stopped"):
        stage.wait()
    timer.join()
    assert answers == [StopAnswer(stopped=True)]
    assert 0.5 < stage.position().position_mm < 30.0
    with pytest.raises(MotionFailed, match="stopped"):
        stage.wait()
    stage.move_to(0.0)
    gsc.counts_per_s = 40_000
    assert stage.wait().position_mm == 0.0


def test_stop_ends_homing_and_leaves_no_zero(stage: SerialStage, gsc: Gsc) -> None:
    gsc.go(30_000)
    gsc.counts_per_s = 1e9
    time.sleep(0.05)
    gsc.counts_per_s = 5_000
    gsc.start = gsc.target = 30_000
    timer = threading.Timer(0.2, stage.stop)
    timer.start()
    with pytest.raises(MotionFailed, match="stopped"):
        stage.home()
    timer.join()
    assert stage.state().condition == StageCondition.NO_ZERO
    assert stage.state().position is None


def test_a_home_that_nobody_sees_is_proved_by_a_short_way_there_and_back(
    stage: SerialStage, peer: Peer, gsc: Gsc
) -> None:
    assert stage.home() == Position(0.0, measured=True)
    homes = [place for place, frame in enumerate(peer.heard) if frame == b"H:1\r\n"]
    assert len(homes) == 2
    assert b"A:1+P500\r\n" in peer.heard[slice(*homes)]
    # It stands elsewhere: that it goes is seen.
    gsc.start = gsc.target = 4000
    stage.home()
    assert peer.heard.count(b"H:1\r\n") == 3


def test_a_zero_that_lies_on_the_limit_switch_is_left_and_found(stage: SerialStage, peer: Peer, gsc: Gsc) -> None:
    gsc.counts_per_s = 5_000.0
    # The switch lets go of it only after some of the way.
    peer.answer = lambda frame: gsc(frame).replace(b",K,K,", b",K,L,") if gsc.counts() < 300 else gsc(frame)
    assert stage.home() == Position(0.0, measured=True)
    assert peer.heard.count(b"H:1\r\n") == 2


def test_a_controller_that_accepts_and_does_not_move_has_no_zero(stage: SerialStage, gsc: Gsc) -> None:
    gsc.override = {b"H:": b"OK\r\n", b"G:": b"OK\r\n"}
    with pytest.raises(MotionFailed, match=r"-0\.5000 mm from its target"):
        stage.home()
    assert stage.state().position is None
    # Its motor turns, but it does not home.
    gsc.override = {b"H:": b"OK\r\n"}
    with pytest.raises(MotionFailed, match="at 500 counts, not at 0"):
        stage.home()
    assert stage.state().position is None


def test_homing_is_bounded(peer: Peer, stage_on: Build, gsc: Gsc) -> None:
    stage = stage_on(peer, "gsc", home_timeout_s=0.3)
    gsc.start = gsc.target = 30_000
    gsc.counts_per_s = 1_000
    with pytest.raises(TimedOut, match="homing"):
        stage.home()
    assert b"L:E\r\n" in peer.heard


def test_only_one_operation_at_a_time(stage: SerialStage, peer: Peer, gsc: Gsc) -> None:
    gsc.start = gsc.target = 20_000
    gsc.counts_per_s = 10_000
    homing = threading.Thread(target=stage.home)
    homing.start()
    until(lambda: b"H:1\r\n" in peer.heard)
    with pytest.raises(Refused, match="under way"):
        stage.move_to(1.0)
    assert stage.state().condition == StageCondition.MOVING
    homing.join()
    assert stage.position() == Position(0.0, measured=True)


def test_speed_is_set_to_what_the_controller_takes(stage: SerialStage, peer: Peer) -> None:
    assert stage.set_speed(2.0004) == 2.0
    assert peer.heard[-1] == b"D:1S500F2000R200\r\n"
    assert stage.state().speed_mm_per_s == 2.0
    with pytest.raises(Refused, match="out of range"):
        stage.set_speed(20.1)


def test_a_no_of_the_controller_is_refused_and_nothing_counts_as_moved(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.override[b"G:"] = b"NG\r\n"
    with pytest.raises(Refused, match="G:"):
        stage.move_to(1.0)
    with pytest.raises(Refused):
        stage.wait()
    assert stage.position().position_mm == 0.0


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (b"", TimedOut),
        (b"       10", TimedOut),
        (b"\xff\xfe\x00\r\n", GarbledReply),
        (b"OK\r\n", GarbledReply),
        (b"9" * 400, GarbledReply),
    ],
    ids=["silent", "partial", "garbage", "another answer", "too long"],
)
def test_bad_replies_end_in_a_typed_error_within_a_bound(
    stage: SerialStage, gsc: Gsc, answer: bytes, error: type[InstrumentError]
) -> None:
    stage.home()
    gsc.override[b"Q:"] = answer
    began_s = time.monotonic()
    with pytest.raises(error) as caught:
        stage.position()
    assert time.monotonic() - began_s < HANG_S
    assert caught.value.device == "stage1"
    assert caught.value.remedy
    assert stage.state().condition == StageCondition.FAILED
    gsc.override.clear()
    assert stage.position() == Position(0.0, measured=True)


def test_a_late_reply_is_not_taken_for_the_next_one(stage: SerialStage, gsc: Gsc, peer: Peer) -> None:
    stage.home()
    gsc.override[b"Q:"] = b""
    with pytest.raises(TimedOut):
        stage.position()
    gsc.override.clear()
    peer.say(b"      9999,K,K,R\r\n")
    assert stage.position().position_mm == 0.0


def test_a_peer_that_never_stops_sending_is_garbled_within_a_bound(stage: SerialStage, peer: Peer, gsc: Gsc) -> None:
    stage.home()
    gsc.override[b"Q:"] = b""
    over = threading.Event()

    def flood() -> None:
        while not over.is_set():
            peer.say(b"K,K,R,")

    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        for _ in range(3):
            began_s = time.monotonic()
            with pytest.raises(GarbledReply, match="sending"):
                stage.position()
            assert time.monotonic() - began_s < HANG_S
    finally:
        over.set()
        flooding.join()
    gsc.override.clear()
    assert stage.position() == Position(0.0, measured=True)


def test_open_finds_out_that_nothing_answers(peer_at: PeerAt, stage_on: Build) -> None:
    stage = stage_on(peer_at(), "gsc", opened=False)
    with pytest.raises(NotConnected, match="no answer") as caught:
        stage.open()
    assert "9600 baud" in caught.value.remedy
    assert stage.state().condition == StageCondition.CLOSED


def test_open_ends_a_motion_that_was_going_on(peer: Peer, stage_on: Build, gsc: Gsc) -> None:
    gsc.counts_per_s = 1_000
    gsc.go(100_000)
    stage_on(peer, "gsc")
    assert b"L:E\r\n" in peer.heard
    assert not gsc.busy()


def test_close_stops_the_motion_and_open_works_again(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    gsc.counts_per_s = 1_000
    stage.move_to(40.0)
    stage.close()
    stage.close()
    assert not gsc.busy()
    with pytest.raises(NotConnected, match="not open"):
        stage.position()
    assert stage.stop() == StopAnswer(stopped=True)
    stage.open()
    assert stage.state().condition == StageCondition.NO_ZERO


def test_counts_that_change_by_themselves_cost_the_zero(stage: SerialStage, gsc: Gsc) -> None:
    stage.home()
    stage.move_to(5.0)
    stage.wait()
    gsc.start = gsc.target = 0  # the controller was switched off and on
    with pytest.raises(Refused, match="changed from 5000 to 0"):
        stage.move_to(6.0)
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(6.0)


def test_stop_is_told_again_after_one_bad_answer(stage: SerialStage, peer: Peer, gsc: Gsc) -> None:
    stage.home()
    gsc.counts_per_s = 1_000
    stage.move_to(40.0)
    bad = [b"#?\r\n"]
    peer.answer = lambda frame: bad.pop() if frame == b"L:E\r\n" and bad else gsc(frame)
    assert stage.stop() == StopAnswer(stopped=True)
    assert peer.heard.count(b"L:E\r\n") == 2


def test_the_frames_of_a_move_can_be_seen_before_anything_is_sent(peer: Peer, stage_on: Build) -> None:
    stage = stage_on(peer, "gsc", opened=False)
    assert stage.preview(-1.5) == (b"A:1-P1500\r\n", b"G:\r\n")
    assert peer.heard == []
