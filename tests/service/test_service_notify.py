"""What systemd is told."""

import asyncio
import logging
import os
import socket
import time
from pathlib import Path

import pytest

from irpmd_rig.service.notify import Notifier


@pytest.fixture
def manager(tmp_path: Path) -> socket.socket:
    line = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    line.bind(str(tmp_path / "notify"))
    line.settimeout(30)
    return line


def test_it_is_told_in_one_datagram(manager: socket.socket) -> None:
    with manager:
        Notifier({"NOTIFY_SOCKET": manager.getsockname()}).tell(READY="1", STATUS="answers")
        assert manager.recv(100) == b"READY=1\nSTATUS=answers"


def test_where_nobody_listens_nothing_happens(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    Notifier({}).tell(READY="1")
    assert not caplog.records
    with caplog.at_level(logging.WARNING):
        Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody")}).tell(READY="1")
    assert "cannot be told" in caplog.text


@pytest.mark.parametrize(
    ("environment", "expected_s"),
    [
        ({"WATCHDOG_USEC": "20000000"}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": str(os.getpid())}, 20.0),
        ({"WATCHDOG_USEC": "20000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_for_this_process(environment: dict[str, str], expected_s: float | None) -> None:
    assert Notifier(environment).watchdog_s == expected_s


def test_a_loop_that_hangs_does_not_feed_the_watchdog(manager: socket.socket) -> None:
    environment = {"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "90000"}

    async def hang() -> int:
        feeding = asyncio.create_task(Notifier(environment).feed())
        await fed(manager)
        time.sleep(0.3)  # as a program that hangs does
        meanwhile = waiting(manager)
        await fed(manager)
        feeding.cancel()
        await asyncio.wait([feeding])
        return meanwhile

    with manager:
        assert asyncio.run(hang()) == 0


async def fed(manager: socket.socket) -> None:
    """Wait until it was told twice that all is well."""
    async with asyncio.timeout(30):
        found = 0
        while found < 2:
            await asyncio.sleep(0.01)
            found += waiting(manager)


def waiting(manager: socket.socket) -> int:
    """Count the datagrams that have arrived."""
    manager.setblocking(False)
    found = 0
    try:
        while manager.recv(100) == b"WATCHDOG=1":
            found += 1
    except BlockingIOError:
        return found
    raise AssertionError("something else was told")
