"""What a serial line is, and what can go wrong on the way back from a controller."""

import threading
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class LineSettings:
    """The one setting of the line (8 data bits, no parity, 1 stop bit) at which a controller understands."""

    baud: int


class Firmware(Protocol):
    """A controller: bytes in, bytes out."""

    line: LineSettings

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and return the reply, often empty."""
        ...


class LineFaults:
    """Faults of the replies of one line, switchable from any thread while it runs.

    `mute` swallows all replies, `slow_s` holds each back for that long (of the world's time), `endless` sends
    an unending row of digits instead of a reply, until it is switched off.
    """

    def __init__(self) -> None:
        self.mute = False
        self.slow_s = 0.0
        self.endless = False
        self._lock = threading.Lock()
        self._garbled = 0
        self._cut = 0

    def garble_next(self, replies: int = 1) -> None:
        """Disturb the next replies: every second bit of every byte flips."""
        with self._lock:
            self._garbled += replies

    def cut_next(self, replies: int = 1) -> None:
        """Lose the second half of the next replies, with their end."""
        with self._lock:
            self._cut += replies

    def clear(self) -> None:
        """Take all faults back."""
        with self._lock:
            self.mute, self.slow_s, self.endless = False, 0.0, False
            self._garbled = self._cut = 0

    def disturb(self, reply: bytes) -> bytes:
        """Return what of a reply reaches the line."""
        with self._lock:
            if not reply or self.mute:
                return b""
            if self._garbled:
                self._garbled -= 1
                return bytes(byte ^ 0x55 for byte in reply)
            if self._cut:
                self._cut -= 1
                return reply[: len(reply) // 2]
            return reply
