"""Serves a controller on a serial line (a pseudo-terminal) or on a TCP socket.

A pseudo-terminal has no line, so nothing on it depends on the baud rate; but the settings that the other
side asked for can be read at this end, and a controller that was asked with the wrong ones does not
understand. Linux gives every pseudo-terminal 8 data bits and no parity, whatever was asked: those cannot be
checked.
"""

import contextlib
import os
import select
import socket
import termios
import threading
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from sims.clock import WorldClock
from sims.stage.line import Firmware, LineFaults

BAUDS = {getattr(termios, f"B{baud}"): baud for baud in (2400, 4800, 9600, 19200, 38400, 57600, 115200)}
ENDLESS_CHUNK = b"0123456789" * 4
ENDLESS_PAUSE_S = 0.01
READ_BYTES = 4096
LONGEST_NAP_S = 0.05


class _Service:
    """A thread that carries bytes between one descriptor and a controller until it is told to end."""

    def __init__(
        self,
        descriptor: int,
        answer: Callable[[bytes], bytes],
        faults: LineFaults,
        clock: WorldClock,
    ) -> None:
        self._descriptor = descriptor
        self._answer = answer
        self._faults = faults
        self._clock = clock
        self._wake_read, self._wake_write = os.pipe()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="serial-line", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread; the descriptor stays open."""
        self._ended.set()
        os.write(self._wake_write, b"x")
        self._thread.join()
        os.close(self._wake_read)
        os.close(self._wake_write)

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while not self._ended.is_set():
                pause_s = ENDLESS_PAUSE_S if self._faults.endless else None
                ready, _, _ = select.select([self._descriptor, self._wake_read], [], [], pause_s)
                if self._wake_read in ready:
                    return
                if not ready:
                    self._write(ENDLESS_CHUNK)
                    continue
                data = os.read(self._descriptor, READ_BYTES)
                if not data:
                    return
                self._reply(self._answer(data))

    def _reply(self, reply: bytes) -> None:
        disturbed = self._faults.disturb(reply)
        if not disturbed:
            return
        self._hold_back()
        self._write(ENDLESS_CHUNK if self._faults.endless else disturbed)

    def _hold_back(self) -> None:
        """Wait in short pieces, so that a line with a slow reply can be torn out meanwhile."""
        due_s = self._clock.now() + self._faults.slow_s
        while (left_s := due_s - self._clock.now()) > 0 and not self._ended.is_set():
            self._clock.sleep(min(left_s, LONGEST_NAP_S))

    def _write(self, data: bytes) -> None:
        """Write, but never wait for a client that does not read: what does not fit is lost, as on a wire."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._descriptor, data)


class SerialPort:
    """A controller on a pseudo-terminal that a symbolic link names.

    Parameters
    ----------
    firmware
        The controller.
    link
        Path of the symbolic link that stands for the serial port.
    clock
        The clock of the world.
    faults
        Faults of the replies.
    wrong_line
        What a wrong baud rate or number of stop bits yields: nothing, or a few garbage bytes.
    """

    def __init__(
        self,
        firmware: Firmware,
        link: Path,
        clock: WorldClock,
        faults: LineFaults,
        *,
        wrong_line: Literal["silent", "garbage"] = "silent",
    ) -> None:
        self._firmware = firmware
        self.link = link
        self._clock = clock
        self._faults = faults
        self._wrong_line = wrong_line
        self._descriptors: tuple[int, int] | None = None
        self._service: _Service | None = None
        # A fault script and the end of the world may both tear the port out.
        self._plugging = threading.Lock()

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._descriptors is not None

    def plug(self) -> None:
        """Make the port appear."""
        with self._plugging:
            if self._descriptors is None:
                self._appear()

    def _appear(self) -> None:
        master, slave = os.openpty()
        # Raw before anyone can write: a cooked line would echo replies back as commands. The slave stays open
        # here: without any slave open, the master reads errors instead of waiting.
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._descriptors = master, slave
        self._service = _Service(master, self._answer, self._faults, self._clock)
        self.link.parent.mkdir(parents=True, exist_ok=True)
        beside = self.link.with_name(self.link.name + ".new")
        beside.unlink(missing_ok=True)
        # Not its name under /dev/pts: were this process killed, the next terminal that anyone opens would get it.
        beside.symlink_to(f"/proc/{os.getpid()}/fd/{slave}")
        beside.rename(self.link)

    def unplug(self) -> None:
        """Tear the port out: its name is gone and whoever has it open gets errors."""
        with self._plugging:
            if self._descriptors is None or self._service is None:
                return
            self.link.unlink(missing_ok=True)
            self._service.end()
            for descriptor in self._descriptors:
                os.close(descriptor)
            self._descriptors = self._service = None

    close = unplug

    def _answer(self, data: bytes) -> bytes:
        if not self._line_is_right():
            return bytes(byte ^ 0xAA for byte in data[:4]) if self._wrong_line == "garbage" else b""
        return self._firmware.receive(data)

    def _line_is_right(self) -> bool:
        assert self._descriptors is not None
        _, _, control, _, in_speed, out_speed, _ = termios.tcgetattr(self._descriptors[0])
        baud = self._firmware.line.baud
        return BAUDS.get(in_speed) == BAUDS.get(out_speed) == baud and not control & termios.CSTOPB


class SocketPort:
    """A controller on a TCP port of this machine, as behind a serial device server: one client at a time.

    Parameters
    ----------
    firmware
        The controller.
    clock
        The clock of the world.
    faults
        Faults of the replies.
    port
        The TCP port; 0 takes a free one.
    """

    def __init__(self, firmware: Firmware, clock: WorldClock, faults: LineFaults, port: int = 0) -> None:
        self._firmware = firmware
        self._clock = clock
        self._faults = faults
        self._port = port
        self._listener: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._client: tuple[socket.socket, _Service] | None = None
        self._lock = threading.Lock()
        self._plugging = threading.Lock()

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._listener is not None

    @property
    def url(self) -> str:
        """The address in pyserial's form, `socket://127.0.0.1:PORT`."""
        return f"socket://127.0.0.1:{self._port}"

    def plug(self) -> None:
        """Listen."""
        with self._plugging:
            if self._listener is not None:
                return
            self._listener = socket.create_server(("127.0.0.1", self._port))
            self._port = self._listener.getsockname()[1]
            self._thread = threading.Thread(target=self._accept, args=(self._listener,), daemon=True)
            self._thread.start()

    def unplug(self) -> None:
        """Stop listening and drop the client."""
        with self._plugging:
            if self._listener is None or self._thread is None:
                return
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            self._thread.join()
            self._listener.close()
            self._listener = self._thread = None
            self._drop_client()

    close = unplug

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = listener.accept()
                self._drop_client()
                client.setblocking(False)
                service = _Service(client.fileno(), self._firmware.receive, self._faults, self._clock)
                with self._lock:
                    self._client = client, service

    def _drop_client(self) -> None:
        with self._lock:
            dropped, self._client = self._client, None
        if dropped is not None:
            client, service = dropped
            service.end()
            client.close()
