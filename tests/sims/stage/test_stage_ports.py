"""The line itself, through plain pyserial: wrong settings, unplugging, faults of the replies, and what stays
behind."""

import itertools
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import serial

from sims.clock import Clock
from sims.stage import AxisSettings, Gcd0301m, Gcd040101m, Gsc, StageTwin
from tests.small_world import until

TIME_SCALE = 20.0
AXES = {1: AxisSettings(start_mm=100, ringing_um=0, backlash_um=0, noise_um=0)}


@pytest.fixture
def link(tmp_path: Path) -> Path:
    return tmp_path / "ports" / "stage1"


@pytest.fixture
def stage(link: Path) -> Iterator[StageTwin]:
    twin = StageTwin(AXES, Gsc, Clock(TIME_SCALE), link=link, seed=1)
    twin.start()
    yield twin
    twin.close()


def ask(port: serial.Serial, command: bytes) -> bytes:
    port.write(command + b"\r\n")
    return port.read_until(b"\r\n")


def wait_ready(port: serial.Serial) -> None:
    while ask(port, b"!:") == b"B\r\n":
        time.sleep(0.005)


def test_a_plain_client_moves_the_stage(stage: StageTwin, link: Path) -> None:
    with serial.Serial(str(link), 9600, timeout=20) as port:
        assert ask(port, b"A:1+P5000") == b"OK\r\n"
        assert ask(port, b"G:") == b"OK\r\n"
        wait_ready(port)
        assert ask(port, b"Q:") == b"      5000,K,K,R\r\n"
    assert stage.position_mm(1) == pytest.approx(105.0)


def test_a_write_only_controller_obeys_and_stays_silent(link: Path) -> None:
    # Frames that a held-up thread reads at once count all the same.
    twin = StageTwin(AXES, partial(Gcd0301m, shortest_gap_s=0.0), Clock(TIME_SCALE), link=link)
    twin.start()
    with serial.Serial(str(link), 19200, timeout=0.05) as port:
        for frame in (b"@1D01\r\n", b"@1SEF\r\n", b"@1P000003E8\r\n", b"@0G\r\n"):
            port.write(frame)
            assert port.read(1) == b""
        until(lambda: twin.position_mm(1) == pytest.approx(101.0))
        assert port.read(1) == b""
    twin.close()


@pytest.mark.parametrize(
    "wrong",
    [{"baudrate": 19200}, {"stopbits": 2}],
    ids=lambda wrong: next(iter(wrong)),
)
@pytest.mark.usefixtures("stage")
def test_a_wrong_line_setting_is_not_understood(link: Path, wrong: dict[str, object]) -> None:
    with serial.Serial(str(link), **({"baudrate": 9600, "timeout": 0.1} | wrong)) as port:
        assert ask(port, b"!:") == b""
    with serial.Serial(str(link), 9600, timeout=20) as port:
        assert ask(port, b"!:") == b"R\r\n"


def test_a_wrong_baud_rate_may_also_read_as_garbage(link: Path) -> None:
    twin = StageTwin(AXES, Gcd040101m, Clock(), link=link, wrong_line="garbage")
    twin.start()
    with serial.Serial(str(link), 19200, timeout=3) as port:
        port.write(b"!:\r\n")
        assert port.read(4) not in (b"", b"!:\r\n")
    twin.close()


def test_unplugging_breaks_an_open_port_and_replugging_makes_a_new_one(stage: StageTwin, link: Path) -> None:
    with serial.Serial(str(link), 9600, timeout=20) as port:
        assert ask(port, b"A:1+P1000") == b"OK\r\n"
        assert ask(port, b"G:") == b"OK\r\n"
        stage.faults.unplug()
        with pytest.raises(serial.SerialException):
            ask(port, b"!:")
        with pytest.raises(OSError, match="Input/output error"):
            _ = port.in_waiting
    assert not link.exists()
    assert not stage.plugged
    time.sleep(0.1)
    stage.faults.replug()
    with serial.Serial(str(link), 9600, timeout=20) as port:
        wait_ready(port)
        assert ask(port, b"Q:") == b"      1000,K,K,R\r\n"


def test_unplugging_ends_a_read_that_waits(stage: StageTwin, link: Path) -> None:
    with serial.Serial(str(link), 9600, timeout=100) as port:
        threading.Timer(0.1, stage.faults.unplug).start()
        begun_s = time.monotonic()
        with pytest.raises(serial.SerialException):
            port.read(1)
        assert time.monotonic() - begun_s < 30


def test_replies_can_be_garbled_cut_muted_slow_or_endless(stage: StageTwin, link: Path) -> None:
    line = stage.faults.line
    with serial.Serial(str(link), 9600, timeout=1.5) as port:
        line.garble_next()
        port.write(b"!:\r\n")
        assert port.read(3) == bytes(b ^ 0x55 for b in b"R\r\n")
        line.cut_next()
        assert ask(port, b"Q:") == b" " * 9
        line.mute = True
        assert ask(port, b"!:") == b""
        line.mute = False
        line.slow_s = 0.1 * TIME_SCALE
        begun_s = time.monotonic()
        assert ask(port, b"!:") == b"R\r\n"
        assert time.monotonic() - begun_s >= 0.1
        line.clear()
        line.endless = True
        port.write(b"!:\r\n")
        assert len(port.read(500)) == 500
        line.endless = False
        time.sleep(0.5)
        port.reset_input_buffer()
        assert ask(port, b"!:") == b"R\r\n"


def test_faults_of_a_move_reach_the_wire(stage: StageTwin, link: Path) -> None:
    with serial.Serial(str(link), 9600, timeout=20) as port:
        stage.faults.stall_next_move(fraction=0.5)
        ask(port, b"A:1+P1000"), ask(port, b"G:")
        until(lambda: ask(port, b"Q:") == b"       500,K,K,B\r\n")
        assert ask(port, b"L:E") == b"OK\r\n"
        stage.faults.overshoot_next_move(by_mm=0.05)
        ask(port, b"A:1+P1000"), ask(port, b"G:")
        wait_ready(port)
        assert ask(port, b"Q:") == b"      1050,K,K,R\r\n"
        stage.faults.limit_next_move()
        ask(port, b"A:1+P50"), ask(port, b"G:")
        wait_ready(port)
        assert ask(port, b"Q:") == b"       550,K,L,R\r\n"
        stage.faults.lose_steps(counts=20)
        ask(port, b"A:1+P1550"), ask(port, b"G:")
        wait_ready(port)
        assert ask(port, b"Q:") == b"      1550,K,K,R\r\n"
    assert stage.position_mm(1) == pytest.approx(101.53)


def test_a_socket_serves_the_same_controller() -> None:
    twin = StageTwin(AXES, Gsc, Clock(TIME_SCALE), link=None)
    twin.start()
    url = twin.url
    with serial.serial_for_url(url, timeout=20) as port:
        assert ask(port, b"M:1+P100") == b"OK\r\n"
    # A bare socket: pyserial does not close its own if the other end went first.
    address = urlsplit(url)
    with socket.create_connection((address.hostname, address.port), timeout=20) as client:
        client.sendall(b"G:\r\n")
        assert client.recv(4) == b"OK\r\n"
        twin.faults.unplug()
        assert client.recv(4) == b""
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url, timeout=20)
    twin.faults.replug()
    assert twin.url == url
    with serial.serial_for_url(url, timeout=20) as port:
        wait_ready(port)
    twin.close()


def test_nothing_stays_behind(tmp_path: Path) -> None:
    def count() -> tuple[int, int]:
        return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))

    before = count()
    for name in ("a", "b", "c"):
        for link in (tmp_path / name, None):
            twin = StageTwin(AXES, Gsc, Clock(), link=link)
            twin.start()
            with serial.serial_for_url(twin.url, timeout=20) as port:
                assert ask(port, b"!:") == b"R\r\n"
            twin.faults.unplug()
            twin.faults.replug()
            twin.close()
            twin.close()
    assert count() == before
    assert list(tmp_path.iterdir()) == []


def test_a_port_of_a_killed_world_leads_nowhere(link: Path) -> None:
    """The kernel gives the terminal's number to the next one that is opened, anybody's."""
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom sims.clock import Clock\n"
        "from sims.stage import AxisSettings, Gsc, StageTwin\n"
        f"StageTwin({{1: AxisSettings()}}, Gsc, Clock(), link=Path({str(link)!r})).start()\n"
        "print('there', flush=True)\ntime.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as world:
        try:
            assert world.stdout is not None
            assert world.stdout.readline() == b"there\n"
            with serial.Serial(str(link), 9600, timeout=20, exclusive=True) as port:
                assert ask(port, b"!:") == b"R\r\n"
                with pytest.raises(serial.SerialException, match="exclusively"):
                    serial.Serial(str(link), 9600, exclusive=True)
        finally:
            world.kill()
    strangers = [os.openpty() for _ in range(4)]
    try:
        assert link.is_symlink()
        with pytest.raises(serial.SerialException, match="No such file"):
            serial.Serial(str(link), 9600)
    finally:
        for descriptor in itertools.chain(*strangers):
            os.close(descriptor)
