"""How the bus and the USB library of a driver's process speak to each other.

One message is one call of that library or its answer: two 32-bit numbers (bytes of JSON, bytes of data), then
both. A process keeps as many connections as it has calls under way, so that a read that waits holds up
nothing; they belong together by the session's name that each says first.
"""

import json
import socket
import struct
from typing import Any

HEAD = struct.Struct("<II")
LARGEST_PART = 1 << 20


def send_message(connection: socket.socket, head: dict[str, Any], data: bytes = b"") -> None:
    """Send one message."""
    text = json.dumps(head).encode()
    connection.sendall(HEAD.pack(len(text), len(data)) + text + data)


def receive_message(connection: socket.socket) -> tuple[dict[str, Any], bytes]:
    """Receive one message; ConnectionError if the other end has gone."""
    text_bytes, data_bytes = HEAD.unpack(_receive(connection, HEAD.size))
    head: dict[str, Any] = json.loads(_receive(connection, text_bytes))
    return head, _receive(connection, data_bytes)


def _receive(connection: socket.socket, count: int) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        part = connection.recv(min(count - len(parts), LARGEST_PART))
        if not part:
            raise ConnectionError("the other end has gone")
        parts += part
    return bytes(parts)
