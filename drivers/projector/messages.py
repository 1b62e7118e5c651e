"""How a driver and a process of its own speak to each other: JSON, then bytes, each with its length before it."""

import json
import os
import select
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

_HEAD = struct.Struct("<IQ")
# Within it a process that is not held up ends by itself.
GRACE_S = 1.0


class Failure(Exception):
    """What went wrong in the process, as (name of the error, what, remedy)."""

    @property
    def message(self) -> dict[str, str]:
        """As it is sent."""
        kind, what, remedy = self.args
        return {"error": kind, "what": what, "remedy": remedy}


def run(serve: Callable[[socket.socket, dict[str, Any]], None]) -> None:
    """Be the process: serve on the socket whose number is the first argument, with the options in the second."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        end_with(connection)
        try:
            serve(connection, json.loads(sys.argv[2]))
        except OSError:
            return


def send(connection: socket.socket, head: dict[str, Any], data: bytes = b"") -> None:
    """Send one message; OSError if the other end has gone or does not take it in time."""
    text = json.dumps(head).encode()
    connection.sendall(_HEAD.pack(len(text), len(data)) + text)
    connection.sendall(data)


def receive(connection: socket.socket) -> tuple[dict[str, Any], bytes]:
    """Receive one message; OSError if the other end has gone or does not send it in time."""
    text_bytes, data_bytes = _HEAD.unpack(_exactly(connection, _HEAD.size))
    head: dict[str, Any] = json.loads(_exactly(connection, text_bytes))
    return head, _exactly(connection, data_bytes)


def end_with(connection: socket.socket) -> None:
    """End this process when the other end of its socket has gone, also where a library holds it up."""

    def watch() -> None:
        poll = select.poll()
        poll.register(connection, select.POLLRDHUP)
        poll.poll()
        time.sleep(GRACE_S)
        os._exit(1)

    threading.Thread(target=watch, name="other end", daemon=True).start()


def _exactly(connection: socket.socket, count: int) -> bytes:
    buffer = bytearray(count)
    view, got = memoryview(buffer), 0
    while got < count:
        part = connection.recv_into(view[got:])
        if not part:
            raise ConnectionError("the other end has gone")
        got += part
    return bytes(buffer)
