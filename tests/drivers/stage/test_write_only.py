"""A stage that never answers: positions are estimated, ends are computed, and stopping is only cancelling."""

import itertools
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial
from stage_peers import Peer

from drivers.errors import ConfigurationError, DeviceLost, MotionFailed, Refused, TimedOut, Unsupported
from drivers.stage.engine import SerialStage
from drivers.values import Position, StageCondition, StopAnswer
from tests.small_world import until

Build = Callable[..., SerialStage]
PeerAt = Callable[..., Peer]

FACTS: dict[str, Any] = {
    "counts_per_mm": 100.0,
    "speeds": {
        "kind": "table",
        "speeds": [{"code": 0x10, "speed_mm_per_s": 2.0}, {"code": 0xEF, "speed_mm_per_s": 20.0}],
    },
    "speed_mm_per_s": 20.0,
    "ramp_s": 0.1,
    "accept_no_stop": True,
}


@pytest.fixture
def peer(peer_at: PeerAt) -> Peer:
    return peer_at()


@pytest.fixture
def stage(peer: Peer, stage_on: Build, quick: Callable[[str], str]) -> SerialStage:
    return stage_on(peer, quick("gcd-0301m"), **FACTS)


def test_moves_by_differences_and_says_that_it_estimates(stage: SerialStage, peer: Peer) -> None:
    assert stage.zero(10.0, confirmed_by="Ada") == Position(10.0, measured=False)
    stage.move_to(12.55)
    assert stage.wait() == Position(12.55, measured=False)
    stage.move_to(10.0)
    assert stage.wait() == Position(10.0, measured=False)
    until(lambda: len(peer.heard) == 8)
    assert peer.heard == [
        b"@1D01\r\n",
        b"@1SEF\r\n",
        b"@1P000000FF\r\n",
        b"@0G\r\n",
        b"@1D00\r\n",
        b"@1SEF\r\n",
        b"@1P000000FF\r\n",
        b"@0G\r\n",
    ]


def test_the_binary_dialect_moves_in_ten_byte_frames(
    peer_at: PeerAt, stage_on: Build, quick: Callable[[str], str]
) -> None:
    peer = peer_at(frame_bytes=10)
    stage = stage_on(peer, quick("gcd-040101m"), **FACTS, byte_order="little", sign=-1, axis=3)
    stage.zero(0.0, confirmed_by="Ada")
    stage.move_to(2.57)
    stage.wait()
    until(lambda: len(peer.heard) == 4)
    assert [frame.hex(" ") for frame in peer.heard] == [
        "00 00 40 03 44 00 00 00 00 00",
        "00 00 40 03 53 00 ef 00 00 00",
        "00 00 40 03 50 00 01 01 00 00",
        "00 00 40 03 47 00 00 00 00 00",
    ]


def test_the_documented_pace_is_kept(peer: Peer, stage_on: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    # When they were sent, not when a busy machine let the peer hear them.
    sent_at: list[float] = []
    write = serial.Serial.write

    def noted(line: serial.Serial, data: bytes) -> int | None:
        if line.port == peer.url:
            sent_at.append(time.monotonic())
        return write(line, data)

    monkeypatch.setattr(serial.Serial, "write", noted)
    stage = stage_on(peer, "gcd-0301m", **FACTS)
    stage.zero(0.0, confirmed_by="Ada")
    stage.move_to(1.0)
    stage.wait()
    assert time.monotonic() - sent_at[-1] >= 2.0
    pauses = [after - before for before, after in itertools.pairwise(sent_at)]
    assert len(pauses) == 3
    assert min(pauses) >= 0.5
    until(lambda: len(peer.heard) == 4)


def test_rounding_does_not_add_up_over_many_moves(stage: SerialStage, peer: Peer) -> None:
    stage.zero(0.0, confirmed_by="Ada")
    for step in range(1, 4):
        stage.move_to(step * 0.0149)
        stage.wait()
    until(lambda: peer.heard.count(b"@0G\r\n") == 3)
    # 0.0447 mm are 4.47 counts: the pulses that were sent must come to 4.
    pulses = [int(frame[3:11], 16) for frame in peer.heard if frame.startswith(b"@1P")]
    assert sum(pulses) == 4


def test_it_does_not_home_and_needs_a_zero(stage: SerialStage, peer: Peer) -> None:
    with pytest.raises(Unsupported, match="cannot home"):
        stage.home()
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    assert peer.heard == []
    assert stage.capabilities().can_stop is False
    assert stage.capabilities().reads_position is False
    assert len(stage.capabilities().unverified) >= 4


def test_the_position_is_estimated_on_the_way(stage: SerialStage) -> None:
    stage.zero(0.0, confirmed_by="Ada")
    assert stage.set_speed(2.0) == 2.0
    ordered_s = time.monotonic()
    stage.move_to(20.0)
    went_s = time.monotonic()
    time.sleep(0.5)
    least_mm = 2.0 * (time.monotonic() - went_s)
    on_the_way = stage.position()
    most_mm = 2.0 * (time.monotonic() - ordered_s)
    assert on_the_way.measured is False
    assert least_mm <= on_the_way.position_mm + 0.01
    assert on_the_way.position_mm - 0.01 <= most_mm < 19.0
    assert stage.state().condition == StageCondition.MOVING
    with pytest.raises(Refused, match="still moves"):
        stage.move_to(0.0)
    with pytest.raises(Refused, match="still moves"):
        stage.zero(0.0, confirmed_by="Ada")


def test_what_an_earlier_program_may_have_begun_is_waited_for(
    peer: Peer, stage_on: Build, quick: Callable[[str], str]
) -> None:
    facts = FACTS | {"limits_mm": (-20.0, 30.0), "moving_at_open_s": None}
    opened_s = time.monotonic()
    stage = stage_on(peer, quick("gcd-0301m"), **facts)
    assert stage.state().condition == StageCondition.MOVING
    answer = stage.stop()
    assert not answer.stopped
    # 50 mm at 20 mm/s, and the ramp; less what is over.
    assert 2.6 - (time.monotonic() - opened_s) <= answer.ends_in_s <= 2.6
    with pytest.raises(Refused, match="nobody can ask"):
        stage.zero(0.0, confirmed_by="Ada")
    time.sleep(answer.ends_in_s)
    assert stage.state().condition == StageCondition.NO_ZERO
    stage.zero(0.0, confirmed_by="Ada")
    # What this program began itself is known.
    stage.close()
    stage.open()
    assert stage.stop() == StopAnswer(stopped=True)


def test_a_time_out_is_not_done(stage: SerialStage) -> None:
    stage.zero(0.0, confirmed_by="Ada")
    began_s = time.monotonic()
    stage.move_to(20.0)
    with pytest.raises(TimedOut, match="still moving"):
        stage.wait(0.1)
    assert stage.wait() == Position(20.0, measured=False)
    # 20 mm at 20 mm/s and the ramp.
    assert time.monotonic() - began_s >= 1.1


def test_stop_says_when_the_move_ends_by_itself(stage: SerialStage) -> None:
    assert stage.stop() == StopAnswer(stopped=True)
    stage.zero(0.0, confirmed_by="Ada")
    began_s = time.monotonic()
    stage.move_to(20.0)
    answer = stage.stop()
    assert answer.stopped is False
    # 20 mm at 20 mm/s and the ramp, less what is over.
    assert 1.1 - (time.monotonic() - began_s) <= answer.ends_in_s <= 1.1
    assert stage.wait() == Position(20.0, measured=False)
    assert stage.stop() == StopAnswer(stopped=True)


def test_stop_before_go_cancels_the_move(peer: Peer, stage_on: Build) -> None:
    stage = stage_on(peer, "gcd-0301m", **FACTS)
    stage.zero(0.0, confirmed_by="Ada")
    answers: list[StopAnswer] = []
    timer = threading.Timer(0.7, lambda: answers.append(stage.stop()))
    timer.start()
    with pytest.raises(MotionFailed, match="before the move began"):
        stage.move_to(20.0)
    timer.join()
    assert answers == [StopAnswer(stopped=True)]
    assert b"@0G\r\n" not in peer.heard
    assert stage.position() == Position(0.0, measured=False)


def test_an_unplug_during_the_move_leaves_no_position(stage: SerialStage, peer: Peer) -> None:
    stage.zero(0.0, confirmed_by="Ada")
    stage.move_to(40.0)
    threading.Timer(0.2, peer.unplug).start()
    with pytest.raises(DeviceLost):
        stage.wait()
    assert stage.state().condition == StageCondition.LOST
    assert stage.state().position is None
    peer.plug()
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    # The box goes on with its move, line or no line.
    answer = stage.stop()
    assert answer.stopped is False
    assert 0.0 < answer.ends_in_s < 2.0
    assert (stage.state().condition, stage.state().position) == (StageCondition.MOVING, None)
    with pytest.raises(Refused, match="still moves"):
        stage.zero(3.0, confirmed_by="Ada")
    time.sleep(answer.ends_in_s)
    assert stage.stop() == StopAnswer(stopped=True)
    assert stage.zero(3.0, confirmed_by="Ada") == Position(3.0, measured=False)
    stage.move_to(3.1)
    assert stage.wait() == Position(3.1, measured=False)


@pytest.mark.parametrize("again", [False, True])
def test_closing_does_not_end_a_move(
    stage: SerialStage, peer: Peer, stage_on: Build, quick: Callable[[str], str], again: bool
) -> None:
    """Nor does a new driver of the same stage take it for a stage at rest."""
    stage.zero(0.0, confirmed_by="Ada")
    stage.move_to(40.0)
    stage.close()
    assert stage.stop().stopped is False
    if again:
        stage = stage_on(peer, quick("gcd-0301m"), opened=False, **FACTS)
    stage.open()
    assert stage.stop().stopped is False
    assert stage.state().condition == StageCondition.MOVING
    with pytest.raises(Refused, match="still moves"):
        stage.zero(0.0, confirmed_by="Ada")
    time.sleep(stage.stop().ends_in_s)
    assert stage.state().condition == StageCondition.NO_ZERO
    stage.zero(0.0, confirmed_by="Ada")


def test_a_stop_that_nobody_hears_of_is_sent_but_not_believed(
    peer: Peer, stage_on: Build, quick: Callable[[str], str]
) -> None:
    """A lab that found out how its box is stopped, and still cannot ask it where it is."""
    dialect = Path(quick("gcd-0301m"))
    dialect.write_text(dialect.read_text().replace("replies: null", '  stop:\n    - {send: "@0T"}\nreplies: null'))
    stage = stage_on(peer, str(dialect), **FACTS)
    stage.zero(0.0, confirmed_by="Ada")
    assert stage.stop() == StopAnswer(stopped=True)
    stage.move_to(40.0)
    answers: list[StopAnswer] = []
    timer = threading.Timer(0.2, lambda: answers.append(stage.stop()))
    timer.start()
    with pytest.raises(MotionFailed, match="was stopped"):
        stage.wait()
    timer.join()
    until(lambda: peer.heard[-1] == b"@0T\r\n")
    assert answers[0].stopped is False
    assert 0.0 < answers[0].ends_in_s < 2.0
    assert stage.state().position is None
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    time.sleep(answers[0].ends_in_s)
    stage.zero(4.0, confirmed_by="Ada")
    stage.move_to(4.1)
    assert stage.wait() == Position(4.1, measured=False)


@pytest.mark.parametrize("missing", ["counts_per_mm", "speeds", "ramp_s"])
def test_a_fact_that_nobody_knows_must_be_set(peer: Peer, stage_on: Build, missing: str) -> None:
    with pytest.raises(ConfigurationError, match=missing) as caught:
        stage_on(peer, "gcd-0301m", **(FACTS | {missing: None}))
    assert caught.value.location == (missing,)
    assert any(word in caught.value.remedy for word in ("gauge", "time"))


def test_the_byte_order_of_the_binary_dialect_must_be_set(peer: Peer, stage_on: Build) -> None:
    with pytest.raises(ConfigurationError, match="byte_order"):
        stage_on(peer, "gcd-040101m", **FACTS)


def test_that_it_cannot_be_stopped_must_be_acknowledged(peer: Peer, stage_on: Build) -> None:
    with pytest.raises(ConfigurationError, match="cannot stop") as caught:
        stage_on(peer, "gcd-0301m", **(FACTS | {"accept_no_stop": False}))
    assert "emergency switch" in caught.value.remedy
