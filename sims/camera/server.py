"""Serves a simulated camera to GenTL clients: a copy of the producer in a folder, its socket beside it."""

import contextlib
import logging
import os
import shutil
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Lock, Thread
from typing import Self

from sims.camera.build import producer
from sims.camera.device import CameraTwin
from sims.camera.nodemap import XML_ADDRESS, XML_NAME
from sims.camera.stream import FrameStream
from sims.camera.wire import (
    VERSION,
    Operation,
    Refusal,
    Request,
    Status,
    device_record,
    opened_record,
    reply,
)

_log = logging.getLogger(__name__)


@contextlib.contextmanager
def _short_path(path: Path) -> Iterator[str]:
    """Name of a socket that fits into an address however long the path is."""
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


class CameraServer:
    """A camera that clients find through `cti`; a context manager.

    Parameters
    ----------
    camera : CameraTwin
        The camera.
    folder : Path
        Where the copy of the producer and its socket are put. Must exist; a world needs one of its own.
    name : str
        The producer's file name.

    Raises
    ------
    ProducerError
        If the producer cannot be built.

    Attributes
    ----------
    cti : Path
        The producer to give to a GenTL client.
    """

    def __init__(self, camera: CameraTwin, folder: Path, name: str = "irpmd-sim.cti"):
        self.cti = folder.resolve() / name
        self._camera = camera
        self._socket_path = self.cti.with_name(name + ".sock")
        self._lock = Lock()
        self._connections: set[socket.socket] = set()
        self._threads: set[Thread] = set()
        self._session: tuple[int, socket.socket] | None = None
        self._num_sessions = 0
        self._listener: socket.socket | None = None
        self._accepting: Thread | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Put the producer in place and serve."""
        # A copy, not a link: the loader takes two names of one file for the same library.
        temporary = self.cti.with_name(f".{self.cti.name}.{os.getpid()}")
        shutil.copyfile(producer(), temporary)
        temporary.replace(self.cti)
        self._socket_path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        with _short_path(self._socket_path) as address:
            self._listener.bind(address)
        self._listener.listen()
        self._camera.on_unplug(self._unplugged)
        self._accepting = Thread(target=self._accept, args=(self._listener,), name="camera server", daemon=True)
        self._accepting.start()

    def close(self) -> None:
        """End all connections, the camera's acquisition and all threads."""
        if self._listener is None or self._accepting is None:
            return
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._accepting.join()
        self._listener.close()
        self._listener = None
        self._socket_path.unlink(missing_ok=True)
        self._cut_all()
        with self._lock:
            threads = list(self._threads)
        for thread in threads:
            thread.join()
        self._camera.close()

    def _unplugged(self) -> None:
        # At once, not when the connection's thread notices: the next client may come right after a replug.
        with self._lock:
            self._session = None
        self._cut_all()

    def _cut_all(self) -> None:
        with self._lock:
            for connection in self._connections:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            thread = Thread(target=self._serve, args=(connection,), name="camera client", daemon=True)
            with self._lock:
                self._connections.add(connection)
                self._threads.add(thread)
            thread.start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            while self._answer(connection):
                pass
        except (EOFError, OSError):
            pass
        finally:
            self._forget(connection)

    def _forget(self, connection: socket.socket) -> None:
        with self._lock:
            self._connections.discard(connection)
            self._threads = {thread for thread in self._threads if thread.is_alive()}
            ours = self._session is not None and self._session[1] is connection
            if ours:
                self._session = None
        if ours:
            self._camera.release()
        connection.close()

    def _answer(self, connection: socket.socket) -> bool:
        """Answer one request; False where the connection has been served to its end."""
        request, payload = Request.receive(connection)
        try:
            if not self._camera.plugged and request.operation != Operation.LIST:
                raise Refusal(Status.IO, "the camera is unplugged")
            if request.operation == Operation.STREAM:
                self._check_session(request.argument)
                reply(connection, request, Status.SUCCESS)
                self._stream(connection)
                return False
            reply(connection, request, Status.SUCCESS, payload=self._result(connection, request, payload))
        except Refusal as refusal:
            _log.info("refused: %s", refusal)
            reply(connection, request, refusal.status)
        return True

    def _result(self, connection: socket.socket, request: Request, payload: bytes) -> bytes:
        match request.operation:
            case Operation.LIST:
                return self._list(request.argument)
            case Operation.OPEN:
                return self._open(connection, payload.rstrip(b"\0").decode())
        with self._lock:
            ours = self._session is not None and self._session[1] is connection
        if not ours:
            raise Refusal(Status.ERROR, "this connection has not opened the camera")
        if self._camera.faults.answer_s > 0:
            time.sleep(self._camera.faults.answer_s)
        if request.operation == Operation.READ:
            return self._camera.read(request.argument, request.length)
        self._camera.write(request.argument, payload)
        return b""

    def _list(self, version: int) -> bytes:
        if version != VERSION:
            _log.error("a producer of another version asks (%d, not %d): rebuild it", version, VERSION)
            return b""
        with self._lock:
            busy = self._session is not None
        return device_record(self._camera.identity, busy=busy) if self._camera.plugged else b""

    def _open(self, connection: socket.socket, identity: str) -> bytes:
        if identity != self._camera.identity[0]:
            raise Refusal(Status.INVALID_ID, f"there is no camera {identity!r}")
        with self._lock:
            if self._session is not None:
                raise Refusal(Status.ACCESS_DENIED, "another client has opened the camera")
            self._num_sessions += 1
            self._session = (self._num_sessions, connection)
            self._camera.open()
            return opened_record(self._num_sessions, XML_ADDRESS, len(self._camera.node_map.xml), XML_NAME)

    def _check_session(self, session: int) -> None:
        with self._lock:
            if self._session is None or self._session[0] != session:
                raise Refusal(Status.ACCESS_DENIED, "a stream belongs to an opened camera")

    def _stream(self, connection: socket.socket) -> None:
        stream = FrameStream(connection, self._camera.payload_bytes, self._camera.to_ns)
        self._camera.attach(stream)
        try:
            stream.serve()
        finally:
            self._camera.detach(stream)
