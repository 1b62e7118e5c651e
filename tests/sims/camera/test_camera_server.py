"""The server's side of the wire: clients that talk nonsense, long paths, an orderly end."""

import os
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sims.camera import CameraServer, CameraSettings, CameraTwin
from sims.camera.nodemap import XML_ADDRESS
from sims.camera.wire import Status
from sims.clock import Clock

REQUEST = struct.Struct("<IIQII")
REPLY = struct.Struct("<iIQII")
LIST, OPEN, READ, STREAM = 1, 2, 3, 5


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CameraServer]:
    camera = CameraTwin(lambda *_: np.zeros((48, 64), np.uint8), Clock(), CameraSettings(size_px=(64, 48)))
    with CameraServer(camera, tmp_path_factory.mktemp("world")) as running:
        yield running


@contextmanager
def connected(server: CameraServer) -> Iterator[socket.socket]:
    folder = os.open(server.cti.parent, os.O_PATH)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(30)
        connection.connect(f"/proc/self/fd/{folder}/{server.cti.name}.sock")
        os.close(folder)
        yield connection


def ask(
    connection: socket.socket, operation: int, argument: int = 0, length: int = 0, payload: bytes = b""
) -> tuple[int, bytes]:
    connection.sendall(REQUEST.pack(operation, 7, argument, length, len(payload)) + payload)
    status, sequence, _, size, _ = REPLY.unpack(connection.recv(REPLY.size, socket.MSG_WAITALL))
    assert sequence == 7
    return status, connection.recv(size, socket.MSG_WAITALL) if size else b""


def test_the_xml_is_read_in_parts(server: CameraServer) -> None:
    with connected(server) as connection:
        status, opened = ask(connection, OPEN, payload=b"irpmd-rig SIM00001".ljust(64, b"\0"))
        assert status == Status.SUCCESS
        _, address, size = struct.unpack_from("<QQQ", opened)
        assert address == XML_ADDRESS
        parts = [ask(connection, READ, address + offset, min(1000, size - offset)) for offset in range(0, size, 1000)]
        assert b"".join(data for _, data in parts).endswith(b"</RegisterDescription>\n")
        assert ask(connection, READ, address, size + 1)[0] == Status.INVALID_ADDRESS


def test_registers_belong_to_who_opened_the_camera(server: CameraServer) -> None:
    with connected(server) as connection:
        assert ask(connection, READ, XML_ADDRESS, 10)[0] == Status.ERROR
        assert ask(connection, STREAM, 99)[0] == Status.ACCESS_DENIED
        assert ask(connection, OPEN, payload=b"another camera")[0] == Status.INVALID_ID


def test_a_producer_of_another_version_finds_no_camera(server: CameraServer, caplog: pytest.LogCaptureFixture) -> None:
    with connected(server) as connection:
        assert ask(connection, LIST, argument=2) == (Status.SUCCESS, b"")
    assert "another version" in caplog.text


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300))
def test_nonsense_harms_nobody(server: CameraServer, nonsense: bytes) -> None:
    # The server may hang up before it has read all.
    with connected(server) as connection, suppress(ConnectionError):
        connection.sendall(nonsense)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(4096):
            pass
    with connected(server) as connection:
        status, records = ask(connection, LIST, argument=1)
        assert (status, records[:18]) == (Status.SUCCESS, b"irpmd-rig SIM00001")


def test_a_path_may_be_long_and_the_end_is_clean(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 40)
    folder.mkdir()
    camera = CameraTwin(lambda *_: np.zeros((48, 64), np.uint8), Clock(), CameraSettings(size_px=(64, 48)))
    before = set(threading.enumerate())
    for _ in range(2):
        with CameraServer(camera, folder) as server, connected(server) as connection:
            assert ask(connection, LIST, argument=1)[0] == Status.SUCCESS
        assert set(threading.enumerate()) <= before
    assert [path.name for path in folder.iterdir()] == ["irpmd-sim.cti"]
