"""The invented frames of the simulated LightCommander (see `lightcommander_wire.md`)."""

import struct
from dataclasses import dataclass
from enum import IntEnum

REQUEST_MARK, REPLY_MARK = 0xA5, 0x5A
HEAD = struct.Struct("<BBHI")
REPLY_HEAD = struct.Struct("<BBHBBH")
CHECKSUM = struct.Struct("<H")
LARGEST_REQUEST = 131072


class Status(IntEnum):
    """What a reply says of its request."""

    DONE = 0
    UNKNOWN = 1
    LENGTH = 2
    CHECKSUM = 3
    VALUE = 4
    NOT_NOW = 5
    MISMATCH = 6
    TOO_FAST = 7
    TOO_HOT = 8


@dataclass(frozen=True, slots=True)
class Request:
    """One request; `intact` is whether its checksum fits."""

    sequence: int
    opcode: int
    payload: bytes
    intact: bool


class RequestReader:
    """Finds requests in the bytes of bulk transfers."""

    def __init__(self) -> None:
        self._pending = bytearray()

    def forget(self) -> None:
        """Drop a request that was begun."""
        self._pending.clear()

    @property
    def begun(self) -> bool:
        """Whether a request is still incomplete."""
        return bool(self._pending)

    def feed(self, data: bytes) -> list[Request]:
        """Return the requests that these bytes complete."""
        self._pending += data
        requests: list[Request] = []
        while True:
            mark = self._pending.find(REQUEST_MARK)
            del self._pending[: mark if mark >= 0 else len(self._pending)]
            if len(self._pending) < HEAD.size:
                return requests
            _, sequence, opcode, length = HEAD.unpack_from(self._pending)
            if length > LARGEST_REQUEST:
                del self._pending[:1]
                continue
            end = HEAD.size + length
            if len(self._pending) < end + CHECKSUM.size:
                return requests
            (checksum,) = CHECKSUM.unpack_from(self._pending, end)
            intact = sum(self._pending[:end]) & 0xFFFF == checksum
            requests.append(Request(sequence, opcode, bytes(self._pending[HEAD.size : end]), intact))
            del self._pending[: end + CHECKSUM.size]


def reply_frame(request: Request, status: Status, payload: bytes) -> bytes:
    """Return the reply to a request."""
    frame = REPLY_HEAD.pack(REPLY_MARK, request.sequence, request.opcode, status, 0, len(payload)) + payload
    return frame + CHECKSUM.pack(sum(frame) & 0xFFFF)
