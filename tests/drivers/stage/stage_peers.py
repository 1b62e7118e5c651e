"""Scripted peers at the other end of a serial line; they know bytes, and nothing of the driver."""

import os
import re
import select
import socket
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

Answer = Callable[[bytes], bytes]


def silent(_frame: bytes) -> bytes:
    return b""


class Peer:
    """Listens on a pty (behind a link that stays) or a socket, cuts frames, answers, keeps what it heard."""

    def __init__(self, answer: Answer, frame_bytes: int | None, link: Path | None) -> None:
        self.answer = answer
        self.heard: list[bytes] = []
        self.heard_at: list[float] = []
        self._frame_bytes = frame_bytes
        self._link = link
        self._over = threading.Event()
        self._connected = threading.Event()
        self._threads: list[threading.Thread] = []
        if link is None:
            self._listener = socket.create_server(("127.0.0.1", 0))
            self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
            self._run(self._accept)
        else:
            self.url = str(link)
            self.plug()

    def plug(self) -> None:
        """Appear (again) behind the link."""
        self._over.clear()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(self._slave))
        self._run(self._serve, self._master)

    def unplug(self) -> None:
        """Vanish; the link leads nowhere."""
        self._over.set()
        for thread in self._threads:
            thread.join()
        self._threads.clear()
        if self._link is not None:
            os.close(self._master)
            os.close(self._slave)
            self._link.unlink()

    def hang_up(self) -> None:
        """Close the connection, and go on listening for the next."""
        assert self._connected.wait(60.0)
        self._connected.clear()
        self._connection.shutdown(socket.SHUT_RDWR)

    def say(self, data: bytes) -> None:
        """Send something unasked; what does not fit into the line is lost."""
        with suppress(BlockingIOError):
            os.write(self._master, data)

    def end(self) -> None:
        if self._link is not None:
            if not self._over.is_set():
                self.unplug()
            return
        self._over.set()
        self._listener.close()
        for thread in self._threads:
            thread.join()

    def _run(self, target: Callable[..., None], *arguments: Any) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        thread.start()
        self._threads.append(thread)

    def _accept(self) -> None:
        self._listener.settimeout(0.02)
        while not self._over.is_set():
            try:
                self._connection, _ = self._listener.accept()
            except OSError:
                continue
            self._connected.set()
            with self._connection:
                self._serve(self._connection.fileno())

    def _serve(self, descriptor: int) -> None:
        gathered = b""
        while not self._over.is_set():
            try:
                ready, _, _ = select.select([descriptor], [], [], 0.01)
                piece = os.read(descriptor, 4096) if ready else None
            except (OSError, ValueError):
                return
            if piece == b"":
                return
            gathered += piece or b""
            while frame := self._cut(gathered):
                gathered = gathered[len(frame) :]
                self.heard.append(frame)
                self.heard_at.append(time.monotonic())
                if answer := self.answer(frame):
                    with suppress(BlockingIOError):
                        os.write(descriptor, answer)

    def _cut(self, gathered: bytes) -> bytes:
        if self._frame_bytes is not None:
            return gathered[: self._frame_bytes] if len(gathered) >= self._frame_bytes else b""
        end = gathered.find(b"\r\n")
        return gathered[: end + 2] if end >= 0 else b""


class Gsc:
    """Answers like the command table of a GSC-01, and moves at a constant speed of its own."""

    def __init__(self, counts_per_s: float = 40_000.0) -> None:
        self._counts_per_s = counts_per_s
        self.start = self.target = self.pending = 0
        self.began_s = time.monotonic()
        self.stalls_at: int | None = None
        self.limit_at: int | None = None
        self.overshoots_by = 0
        self.override: dict[bytes, bytes] = {}

    @property
    def counts_per_s(self) -> float:
        return self._counts_per_s

    @counts_per_s.setter
    def counts_per_s(self, counts_per_s: float) -> None:
        # What lies behind it was gone at the speed of then.
        self.start, self.began_s = self.counts(), time.monotonic()
        self._counts_per_s = counts_per_s

    def counts(self) -> int:
        way = self.target - self.start
        gone = min(abs(way), int((time.monotonic() - self.began_s) * self.counts_per_s))
        counts = self.start + (gone if way >= 0 else -gone)
        for barrier in (self.stalls_at, self.limit_at):
            if barrier is not None and way > 0:
                counts = min(counts, barrier)
        return counts

    def busy(self) -> bool:
        return self.counts() != self.target and not self.at_limit()

    def at_limit(self) -> bool:
        return self.limit_at is not None and self.counts() >= self.limit_at

    def go(self, target: int) -> None:
        self.start, self.target, self.began_s = self.counts(), target, time.monotonic()

    def __call__(self, frame: bytes) -> bytes:
        if frame[:2] in self.override:
            return self.override[frame[:2]]
        command = frame.decode().strip()
        if command == "Q:":
            sign = "-" if self.counts() < 0 else " "
            limit, busy = "L" if self.at_limit() else "K", "B" if self.busy() else "R"
            return f"{sign}{abs(self.counts()):10d},K,{limit},{busy}\r\n".encode()
        if command == "!:":
            return b"B\r\n" if self.busy() else b"R\r\n"
        return self._command(command)

    def _command(self, command: str) -> bytes:
        if command == "L:E":
            self.go(self.counts())
        elif self.busy():
            return b"NG\r\n"
        elif found := re.fullmatch(r"A:1([+-])P(\d+)", command):
            self.pending = int(found[1] + found[2])
        elif command == "G:":
            self.go(self.pending + self.overshoots_by)
        elif command == "H:1":
            self.go(0)
        elif command == "R:1":
            self.start = self.target = 0
        elif not re.fullmatch(r"D:1S\d+F\d+R\d+", command):
            return b"NG\r\n"
        return b"OK\r\n"
