"""Messages between the program and a camera's worker: JSON objects behind their length, over a socket pair."""

import json
import socket
import struct
from collections import deque
from typing import Any

Message = dict[str, Any]

MESSAGE_LIMIT_BYTES = 64 << 20
_LENGTH = struct.Struct("!I")
_CHUNK_BYTES = 1 << 16
_DESCRIPTORS = 4


class ChannelError(Exception):
    """What came over the channel is no message."""


class Messages:
    """Cuts a stream of bytes into messages."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def feed(self, data: bytes) -> list[Message]:
        """Take bytes, and return the messages that are complete.

        Raises
        ------
        ChannelError
            They are no messages.
        """
        self._pending += data
        complete: list[Message] = []
        while len(self._pending) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._pending)
            if length > MESSAGE_LIMIT_BYTES:
                raise ChannelError(f"a message of {length} bytes is announced")
            end = _LENGTH.size + length
            if len(self._pending) < end:
                break
            complete.append(_decoded(bytes(self._pending[_LENGTH.size : end])))
            del self._pending[:end]
        return complete


class Channel:
    """One end of the socket pair; one thread receives, sending is up to the caller's lock.

    Parameters
    ----------
    connection
        A stream socket of the Unix family; it belongs to the channel from now on.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._messages = Messages()
        self.descriptors: deque[int] = deque()

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return self._socket.fileno()

    def send(self, message: Message, descriptor: int | None = None, *, wait: bool = True) -> None:
        """Send a message, and a descriptor with it.

        Raises
        ------
        OSError
            The other end is gone, or (without `wait`) does not read what it is sent.
        """
        body = json.dumps(message, separators=(",", ":")).encode()
        data = _LENGTH.pack(len(body)) + body
        if descriptor is not None:
            sent = socket.send_fds(self._socket, [data], [descriptor])
            self._socket.sendall(data[sent:])
        elif wait:
            self._socket.sendall(data)
        elif self._socket.send(data, socket.MSG_DONTWAIT) < len(data):
            raise BlockingIOError("the other end does not read")

    def receive(self) -> list[Message]:
        """Wait for bytes and return the messages that they complete; descriptors go to `descriptors`.

        Raises
        ------
        EOFError
            The other end has closed.
        ChannelError
            What came is no message.
        """
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, _CHUNK_BYTES, _DESCRIPTORS)
        except OSError:
            raise EOFError from None
        self.descriptors.extend(descriptors)
        if not data:
            raise EOFError
        return self._messages.feed(data)

    def shut_down(self) -> None:
        """End both directions: `receive` returns at once, here and at the other end."""
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            return

    def close(self) -> None:
        """Close the socket; nobody may be receiving any more."""
        self._socket.close()


def _decoded(body: bytes) -> Message:
    try:
        message = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise ChannelError(f"a message is no JSON: {error}") from None
    if not isinstance(message, dict):
        raise ChannelError("a message is no JSON object")
    return message
