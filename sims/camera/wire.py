"""Records that the GenTL producer (producer/producer.h) and the camera's process exchange, little endian."""

import socket
import struct
from dataclasses import astuple, dataclass
from enum import IntEnum
from typing import ClassVar, Self

VERSION = 1
LONGEST_PAYLOAD = 4096
"""Bytes that a client sends at once; no register is longer."""


class Status(IntEnum):
    """Error codes of the GenTL standard that the camera answers with."""

    SUCCESS = 0
    ERROR = -1001
    RESOURCE_IN_USE = -1004
    ACCESS_DENIED = -1005
    INVALID_ID = -1007
    IO = -1010
    INVALID_ADDRESS = -1015
    INVALID_VALUE = -1019


class Refusal(Exception):
    """The camera refuses a request; the client gets `status`."""

    def __init__(self, status: Status, reason: str):
        super().__init__(reason)
        self.status = status


class Operation(IntEnum):
    """What a client asks for."""

    LIST = 1
    OPEN = 2
    READ = 3
    WRITE = 4
    STREAM = 5
    START = 6
    STOP = 7
    ACKNOWLEDGE = 8


class FrameKind(IntEnum):
    """What a record of the stream says."""

    IMAGE = 1
    STARTED = 2
    STOPPED = 3


@dataclass(frozen=True, slots=True)
class Request:
    """Head of a request; `payload` bytes follow."""

    operation: int
    sequence: int
    argument: int
    length: int
    payload: int

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IIQII")

    @classmethod
    def receive(cls, connection: socket.socket) -> tuple[Self, bytes]:
        """Receive a request and its payload; EOFError at the connection's end."""
        request = cls(*cls.LAYOUT.unpack(receive(connection, cls.LAYOUT.size)))
        if request.payload > LONGEST_PAYLOAD:
            raise EOFError("not a client of ours")
        return request, receive(connection, request.payload)


REPLY = struct.Struct("<iIQII")


def reply(connection: socket.socket, request: Request, status: Status, value: int = 0, payload: bytes = b"") -> None:
    """Answer a request."""
    connection.sendall(REPLY.pack(status, request.sequence, value, len(payload), 0) + payload)


_DEVICE = struct.Struct("<64s64s64s64s64s64sII")
_OPENED = struct.Struct("<QQQ64s")

ACCESS_READWRITE = 1
ACCESS_BUSY = 4


def device_record(identity: tuple[str, str, str, str, str, str], *, busy: bool) -> bytes:
    """Entry of the device list: id, vendor, model, serial number, version, user's name."""
    return _DEVICE.pack(*(text.encode()[:63] for text in identity), ACCESS_BUSY if busy else ACCESS_READWRITE, 0)


def opened_record(session: int, xml_address: int, xml_size: int, xml_name: str) -> bytes:
    """Answer to OPEN."""
    return _OPENED.pack(session, xml_address, xml_size, xml_name.encode())


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame in the shared ring, or a word about the stream."""

    kind: FrameKind
    slot: int = 0
    frame_id: int = 0
    timestamp_ns: int = 0
    offset: int = 0
    size: int = 0
    delivered: int = 0
    pixel_format: int = 0
    width: int = 0
    height: int = 0
    offset_x: int = 0
    offset_y: int = 0
    padding_x: int = 0
    lossless: bool = False

    LAYOUT: ClassVar[struct.Struct] = struct.Struct("<IIQQQQQQIIIIII")

    def pack(self) -> bytes:
        """Return the record as bytes."""
        return self.LAYOUT.pack(*astuple(self))


def receive(connection: socket.socket, size: int) -> bytes:
    """Exactly `size` bytes; EOFError at the connection's end."""
    data = bytearray()
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise EOFError("the client has closed the connection")
        data += part
    return bytes(data)
