"""One line: found or not, shared, lost, and found again; nothing is left behind."""

import gc
import os
import re
import socket
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial
from stage_peers import Gsc, Peer

from drivers.errors import ConfigurationError, DeviceLost, InstrumentError, NotConnected, Refused, TimedOut
from drivers.stage.dialect import Line
from drivers.stage.engine import SerialStage
from drivers.stage.port import Port, never
from drivers.values import Position, StageCondition
from tests.small_world import until

Build = Callable[..., SerialStage]
PeerAt = Callable[..., Peer]

# Bounds of a second or less have ended by then on any machine; what hangs has not.
HANG_S = 30.0


def belongings() -> tuple[int, int]:
    gc.collect()
    return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))


def no_more_than(before: tuple[int, int]) -> bool:
    """Less is what an earlier test left, which ended meanwhile."""
    return all(now <= then for now, then in zip(belongings(), before, strict=True))


def test_the_line_has_the_dialect_s_settings(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage_on(peer, "gsc")
    attributes = termios.tcgetattr(peer._master)
    assert attributes[4] == attributes[5] == termios.B9600
    assert attributes[2] & termios.CSIZE == termios.CS8
    assert not attributes[2] & (termios.PARENB | termios.CSTOPB)


def test_a_rig_file_may_override_the_line(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage_on(peer, "gsc", line={"baud": 38400})
    assert termios.tcgetattr(peer._master)[4] == termios.B38400


@pytest.mark.parametrize(
    ("port", "remedy"),
    [
        ("/dev/there-is-no-such-port", "plug it in"),
        ("/etc/hostname", "plug it in"),
        ("socket://127.0.0.1:1", "plug it in"),
        ("nonsense://x", "socket://host:port"),
        ("socket://", "socket://host:port"),
        ("socket://127.0.0.1", "socket://host:port"),
        ("socket://127.0.0.1:http", "socket://host:port"),
        ("socket://127.0.0.1:99999", "socket://host:port"),
    ],
)
def test_a_wrong_port_says_what_mends_it(peer_at: PeerAt, stage_on: Build, gsc: Gsc, port: str, remedy: str) -> None:
    stage = stage_on(peer_at(gsc), "gsc", opened=False, port=port)
    before = belongings()
    with pytest.raises((NotConnected, ConfigurationError)) as caught:
        stage.open()
    assert caught.value.device == "stage1"
    assert remedy in caught.value.remedy
    until(lambda: no_more_than(before))


def test_a_port_in_use_by_another_program_is_said(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage = stage_on(peer, "gsc", opened=False)
    with serial.serial_for_url(peer.url, exclusive=True), pytest.raises(NotConnected) as caught:
        stage.open()
    assert "another program" in caught.value.remedy


def test_an_unplug_is_lost_at_once_and_a_replug_needs_a_zero_again(
    peer_at: PeerAt, stage_on: Build, gsc: Gsc, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = peer_at(gsc)
    stage = stage_on(peer, "gsc", reconnect_s=0.3)
    stage.home()
    stage.move_to(40.0)
    peer.unplug()
    with pytest.raises(DeviceLost):
        stage.wait()
    with monkeypatch.context() as patch:
        # Nobody is kept waiting.
        patch.setattr("drivers.stage.port.time.sleep", pytest.fail)
        assert stage.state().condition == StageCondition.LOST
    with pytest.raises(DeviceLost, match="gone"):
        stage.home()
    with pytest.raises(DeviceLost):
        stage.stop()
    peer.plug()
    time.sleep(1.1)
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(1.0)
    with pytest.raises(DeviceLost, match="gone"):
        stage.wait()
    assert stage.home() == Position(0.0, measured=True)
    stage.move_to(1.0)
    assert stage.wait().position_mm == 1.0


def test_an_operation_waits_for_the_line_to_come_back(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage = stage_on(peer, "gsc")
    peer.unplug()
    timer = threading.Timer(0.5, peer.plug)
    with pytest.raises(DeviceLost):
        stage.home()
    timer.start()
    assert stage.home() == Position(0.0, measured=True)
    timer.join()


def test_unplugs_leave_no_descriptor_and_no_thread(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage = stage_on(peer, "gsc", opened=False)
    before = belongings()
    for _ in range(4):
        stage.open()
        peer.unplug()
        with pytest.raises(DeviceLost):
            stage.home()
        stage.close()
        peer.plug()
    until(lambda: no_more_than(before))


def test_a_stage_on_a_socket_moves_and_comes_back(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc, by_socket=True)
    stage = stage_on(peer, "gsc")
    stage.home()
    stage.move_to(1.0)
    assert stage.wait() == Position(1.0, measured=True)
    peer.hang_up()
    with pytest.raises((DeviceLost, Refused)):
        stage.move_to(2.0)
    with pytest.raises(Refused, match="no zero"):
        stage.move_to(2.0)
    assert stage.home() == Position(0.0, measured=True)


def test_a_write_only_stage_notices_that_its_socket_was_closed(
    peer_at: PeerAt, stage_on: Build, quick: Callable[[str], str]
) -> None:
    """The first write after the peer closed succeeds, so that a write alone proves nothing."""
    peer = peer_at(by_socket=True)
    stage = stage_on(
        peer,
        quick("gcd-0301m"),
        speeds={"kind": "table", "speeds": [{"code": 1, "speed_mm_per_s": 10.0}]},
        ramp_s=0.0,
        accept_no_stop=True,
        reconnect_s=0.0,
    )
    stage.zero(0.0, confirmed_by="Ada")
    peer.hang_up()
    time.sleep(0.1)
    with pytest.raises(DeviceLost):
        stage.move_to(1.0)
    assert peer.heard == []


def test_a_socket_whose_peer_floods_is_opened_and_closed_within_a_bound(stage_on: Build, peer_at: PeerAt) -> None:
    over = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def flood() -> None:
        connection, _ = listener.accept()
        connection.settimeout(0.05)
        with connection:
            while not over.is_set():
                try:
                    connection.send(b"K" * 4096)
                except TimeoutError:
                    continue
                except OSError:
                    return

    flooding = threading.Thread(target=flood)
    flooding.start()
    stage = stage_on(peer_at(), "gsc", opened=False, port=f"socket://127.0.0.1:{listener.getsockname()[1]}")
    began_s = time.monotonic()
    try:
        with pytest.raises(InstrumentError):
            stage.open()
        assert time.monotonic() - began_s < HANG_S
    finally:
        over.set()
        flooding.join()
        listener.close()


def test_axes_on_one_line_do_not_mix_their_frames(
    peer_at: PeerAt, stage_on: Build, quick: Callable[[str], str]
) -> None:
    peer = peer_at(frame_bytes=10)
    stages = [
        stage_on(
            peer,
            quick("gcd-040101m"),
            name=f"stage{axis}",
            axis=axis,
            byte_order="big",
            speeds={"kind": "table", "speeds": [{"code": 1, "speed_mm_per_s": 10.0}]},
            ramp_s=0.0,
            accept_no_stop=True,
            go_starts_all_axes=False,
        )
        for axis in (1, 2)
    ]

    def move(stage: SerialStage) -> None:
        stage.zero(0.0, confirmed_by="Ada")
        for target_mm in (1.0, 0.0, 1.0):
            stage.move_to(target_mm)
            stage.wait()

    movers = [threading.Thread(target=move, args=(stage,)) for stage in stages]
    for mover in movers:
        mover.start()
    for mover in movers:
        mover.join()
    heard = "".join(f"{chr(frame[4])}{frame[3]}" for frame in peer.heard)
    assert re.fullmatch(r"(D1S1P1G1|D2S2P2G2){6}", heard)


def test_axes_share_a_line_only_where_starting_one_leaves_the_others_alone(peer_at: PeerAt, stage_on: Build) -> None:
    peer = peer_at()
    facts = {
        "speeds": {"kind": "table", "speeds": [{"code": 1, "speed_mm_per_s": 10.0}]},
        "ramp_s": 0.0,
        "accept_no_stop": True,
    }
    stage_on(peer, "gcd-0301m", **facts)
    with pytest.raises(ConfigurationError, match="also used by stage1") as caught:
        stage_on(peer, "gcd-0301m", name="stage2", axis=2, **facts)
    assert "go_starts_all_axes" in caught.value.remedy


def test_axes_on_one_line_have_one_line_setting(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage_on(peer, "gsc")
    with pytest.raises(ConfigurationError, match="other line settings"):
        stage_on(peer, "gsc", name="stage2", line={"baud": 38400})


def test_two_stages_are_never_one_axis(peer_at: PeerAt, stage_on: Build, gsc: Gsc) -> None:
    peer = peer_at(gsc)
    stage_on(peer, "gsc")
    with pytest.raises(ConfigurationError, match=r"axis 1 .* already open as stage1") as caught:
        stage_on(peer, "gsc", name="stage2")
    assert caught.value.location == ("axis",)
    with pytest.raises(ConfigurationError, match="no axis 2"):
        stage_on(peer, "gsc", name="stage2", axis=2)


def test_an_axis_that_closes_leaves_the_line_open(peer_at: PeerAt, stage_on: Build) -> None:
    facts = {
        "speeds": {"kind": "table", "speeds": [{"code": 1, "speed_mm_per_s": 10.0}]},
        "ramp_s": 0.0,
        "accept_no_stop": True,
        "go_starts_all_axes": False,
    }
    peer = peer_at()
    first = stage_on(peer, "gcd-0301m", **facts)
    second = stage_on(peer, "gcd-0301m", name="stage2", axis=2, **facts)
    first.zero(0.0, confirmed_by="Ada")
    second.close()
    assert first.position() == Position(0.0, measured=False)


def test_a_peer_that_takes_no_bytes_ends_in_a_time_out() -> None:
    master, slave = os.openpty()
    port = Port(os.ttyname(slave), Line(baud=9600))
    try:
        port.connect("stage1", patience_s=0.0, cancelled=never)
        began_s = time.monotonic()
        with pytest.raises(TimedOut, match="takes no bytes"):
            port.send("stage1", b"x" * 1_000_000, pause_s=0.0, cancelled=never)
        assert time.monotonic() - began_s < HANG_S
    finally:
        port.close()
        os.close(master)
        os.close(slave)
