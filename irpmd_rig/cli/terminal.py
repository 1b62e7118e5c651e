"""Lines that a person types while other things go on."""

from __future__ import annotations

import os
import select
import sys
import time


class Terminal:
    """Standard input, line by line, without waiting for it."""

    def __init__(self) -> None:
        self._typed = b""
        self._open = True

    @property
    def somebody_there(self) -> bool:
        """Whether anything can still be typed."""
        return self._open

    def line(self, wait_s: float = 0.0) -> str | None:
        """Return the next line without its end; None: none was typed within `wait_s`, or there will be no more."""
        end_s = time.monotonic() + wait_s
        while b"\n" not in self._typed and self._open:
            left_s = max(0.0, end_s - time.monotonic())
            # Not through sys.stdin: what that has read ahead, select does not see.
            if not select.select([sys.stdin.fileno()], [], [], left_s)[0]:
                return None
            piece = os.read(sys.stdin.fileno(), 4096)
            self._open = bool(piece)
            self._typed += piece
        typed, ended, self._typed = self._typed.partition(b"\n")
        return typed.decode(errors="replace").strip() if ended or typed else None

    def forget(self) -> None:
        """Drop what was typed before anything was asked."""
        while self.line() is not None:
            pass
