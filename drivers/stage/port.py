"""One serial line, shared by the axes on it: whole frames only, pacing, loss and coming back."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import serial

from drivers.errors import (
    ConfigurationError,
    DeviceLost,
    GarbledReply,
    InstrumentError,
    NotConnected,
    TimedOut,
)
from drivers.stage.dialect import Line, Replies
from drivers.stage.frames import ReplyReader
from drivers.stage.wire import IO_ERRORS, READ_SLICE_S, Wire, open_wire, reason, remedy

DRAIN_LIMIT_S = 0.25
# Silence that is waited for where the line is not sure to be silent.
QUIET_S = 0.1
FIRST_DELAY_S = 0.1
LAST_DELAY_S = 1.0
# The longest that one axis keeps the line: four paced commands of the slowest dialect and a margin.
LINE_LIMIT_S = 10.0

Cancelled = Callable[[], bool]


def never() -> bool:
    """Stand for an operation that nobody cancels."""
    return False


@dataclass(slots=True)
class _Retry:
    """When the next attempt to open may be made: after a delay that doubles."""

    at_s: float = 0.0
    delay_s: float = FIRST_DELAY_S

    def failed(self) -> None:
        self.at_s = time.monotonic() + self.delay_s
        self.delay_s = min(2 * self.delay_s, LAST_DELAY_S)


class Port:
    """A serial line that several axes use; every method names the axis that it acts for.

    The line is opened by `connect`, and again after a loss. `generation` counts how often: who finds another
    one than before knows that the controllers may have been off meanwhile.
    """

    def __init__(self, url: str, line: Line) -> None:
        self.url = url
        self.line = line
        self.generation = 0
        self._lock = threading.RLock()
        self._serial: Wire | None = None
        self._lost = False
        self._retry = _Retry()
        self._quiet_until_s = 0.0
        self._unsure_s = 0.0

    def connect(self, device: str, *, patience_s: float, cancelled: Cancelled) -> None:
        """Open the line if it is not open; keep trying for `patience_s`.

        Raises
        ------
        NotConnected, DeviceLost
            It cannot be opened; the latter where it once was open.
        ConfigurationError
            No such kind of port or line setting.
        """
        if self._serial is not None:
            return
        end_s = time.monotonic() + patience_s
        while True:
            with self.held(device):
                problem = self._try_open(device)
            if problem is None:
                return
            if self._retry.at_s >= end_s or cancelled():
                raise problem
            time.sleep(max(0.0, min(self._retry.at_s - time.monotonic(), READ_SLICE_S)))

    @contextmanager
    def held(self, device: str, cancelled: Cancelled = never) -> Iterator[bool]:
        """Keep the line for one axis, so that a frame or a whole move goes out unmixed.

        Yields whether it is kept: False where `cancelled` came first.

        Raises
        ------
        TimedOut
            Another axis keeps it too long.
        """
        end_s = time.monotonic() + LINE_LIMIT_S
        while not (mine := self._lock.acquire(timeout=READ_SLICE_S)) and not cancelled():
            if time.monotonic() > end_s:
                raise TimedOut(device, f"the line {self.url} is in use by another axis", "try again")
        try:
            yield mine
        finally:
            if mine:
                self._lock.release()

    def send(self, device: str, frame: bytes, *, pause_s: float, cancelled: Cancelled, urgent: bool = False) -> bool:
        """Write one frame when the pause of the frame before it is over.

        `urgent`: without the silence that is kept after a bad answer.

        Returns
        -------
        bool
            False: `cancelled` came first, and nothing was written.

        Raises
        ------
        DeviceLost
            The line is gone.
        TimedOut
            The other end takes no bytes.
        GarbledReply
            The other end never stops sending.
        """
        with self.held(device, cancelled) as mine:
            while mine and (left_s := self._quiet_until_s - time.monotonic()) > 0 and not cancelled():
                time.sleep(min(left_s, READ_SLICE_S))
            if not mine or cancelled():
                return False
            self._drain(device, 0.0 if urgent else self._unsure_s)
            if cancelled():
                return False
            try:
                self._opened(device).write(frame)
            except serial.SerialTimeoutException:
                self._unsure_s = max(self._unsure_s, QUIET_S)
                raise TimedOut(
                    device,
                    f"{self.url} takes no bytes",
                    "check power, cable and flow control of the controller",
                ) from None
            except IO_ERRORS as error:
                raise self._lose(device, error) from None
            self._quiet_until_s = time.monotonic() + pause_s
            return True

    def exchange(self, device: str, frame: bytes, replies: Replies, *, pause_s: float, urgent: bool = False) -> bytes:
        """Write one frame and read its answer, without the terminator; `urgent`: as for `send`.

        Raises
        ------
        TimedOut
            No whole answer in time.
        GarbledReply
            More than any answer holds.
        DeviceLost
            The line is gone.
        """
        with self.held(device):
            self.send(device, frame, pause_s=pause_s, cancelled=never, urgent=urgent)
            reader = ReplyReader(device, replies)
            end_s = time.monotonic() + replies.timeout_s
            # Until an answer is there, what comes later could be taken for the answer to the next question: a
            # controller that missed the bound is given as long again. What an urgent frame is answered may itself
            # be such a late one.
            sure_s = self._unsure_s if urgent else 0.0
            self._unsure_s = max(QUIET_S, replies.timeout_s)
            while time.monotonic() < end_s:
                answer = reader.feed(self._read(device))
                if answer is not None:
                    self._unsure_s = sure_s
                    return answer
        raise TimedOut(
            device,
            f"no answer to {frame!r} within {replies.timeout_s:g} s"
            + (f", only {reader.gathered!r}" if reader.gathered else ""),
            f"check power, cable, dialect and that the controller is set to {self.line.baud} baud",
        )

    def check(self, device: str) -> None:
        """Look whether the line is still there; what it sent unasked is dropped.

        A write alone does not tell: the first one after a peer has closed its socket succeeds.

        Raises
        ------
        DeviceLost
            It is gone.
        """
        with self.held(device):
            self._drain(device, 0.0)

    def close(self) -> None:
        """Close the line."""
        with self._lock:
            self._shut()
            self._lost = False

    def _opened(self, device: str) -> Wire:
        if self._serial is None:
            kind = DeviceLost if self._lost else NotConnected
            raise kind(device, f"{self.url} is not open", "plug it in and try again")
        return self._serial

    def _try_open(self, device: str) -> InstrumentError | None:
        if self._serial is not None:
            return None
        if time.monotonic() < self._retry.at_s and self._lost:
            return self._gone(device)
        try:
            self._serial = open_wire(self.url, self.line)
        except ValueError as error:
            raise ConfigurationError(
                device,
                f"{self.url!r} cannot be a serial port: {error}",
                "give a device such as /dev/ttyUSB0, or socket://host:port",
                ("port",),
            ) from None
        except IO_ERRORS as error:
            self._retry.failed()
            if self._lost:
                return DeviceLost(device, f"{self.url} is gone", "plug it in again, then home or zero the axis")
            return NotConnected(device, f"{self.url} cannot be opened: {reason(error)}", remedy(error))
        self._retry = _Retry()
        self._lost, self._unsure_s = False, 0.0
        self._quiet_until_s = 0.0
        self.generation += 1
        return None

    def _read(self, device: str) -> bytes:
        port = self._opened(device)
        try:
            return port.read(max(1, min(port.in_waiting, 4096)))
        except IO_ERRORS as error:
            raise self._lose(device, error) from None

    def _drain(self, device: str, quiet_s: float) -> None:
        """Drop what was sent unasked, until nothing came for `quiet_s`; once it came, a short silence is its end."""
        port = self._opened(device)
        end_s = time.monotonic() + quiet_s + DRAIN_LIMIT_S
        last_s = time.monotonic()
        while True:
            try:
                waiting = port.in_waiting
                if waiting:
                    port.read(min(waiting, 4096))
                    last_s, quiet_s = time.monotonic(), min(quiet_s, QUIET_S)
                elif time.monotonic() - last_s >= quiet_s:
                    return
                else:
                    time.sleep(READ_SLICE_S)
            except IO_ERRORS as error:
                raise self._lose(device, error) from None
            if time.monotonic() > end_s:
                raise GarbledReply(
                    device,
                    f"{self.url} never stops sending",
                    "check baud rate and dialect, and that no other instrument is on this line",
                )

    def _lose(self, device: str, error: BaseException) -> DeviceLost:
        self._shut()
        self._lost = True
        self._retry = _Retry()
        return self._gone(device, f": {reason(error)}")

    def _gone(self, device: str, why: str = "") -> DeviceLost:
        what = f"{self.url} is gone{why}"
        return DeviceLost(device, what, "plug it in again, then home or zero the axis")

    def _shut(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            with suppress(*IO_ERRORS):
                port.close()


@dataclass(frozen=True, slots=True)
class _User:
    """An axis on a line."""

    number: int
    alone: bool


_ports: dict[str, tuple[Port, dict[str, _User]]] = {}
_ports_lock = threading.Lock()


def acquire(device: str, url: str, line: Line, *, axis: int, alone: bool) -> Port:
    """Get the line of a URL, the same for all axes on it; `release` gives it back.

    Parameters
    ----------
    device
        Name of the axis.
    url
        A device file, or what pyserial's `serial_for_url` takes.
    line
        Its settings.
    axis
        The controller's number of the axis.
    alone
        Whether the axis cannot bear others on the line.

    Raises
    ------
    ConfigurationError
        The other axes on it want other settings, or cannot share.
    """
    # Not resolved: after a replug the same link may lead to another device file.
    key = url if "://" in url else str(Path(url).absolute())
    with _ports_lock:
        port, users = _ports.get(key, (None, {}))
        if port is None:
            port = Port(url, line)
        if port.line != line:
            raise ConfigurationError(
                device,
                f"{url} is used by {', '.join(sorted(users))} with other line settings",
                "axes on one line have one dialect and one line setting",
                ("port",),
            )
        if device in users:
            raise ConfigurationError(device, f"{url} is already open for it", "close it first", ("port",))
        for other, user in users.items():
            if user.number == axis:
                what = f"axis {axis} on {url} is already open as {other}"
                raise ConfigurationError(device, what, "give each stage its own axis, or its own port", ("axis",))
        others = list(users)
        if others and (alone or any(user.alone for user in users.values())):
            raise ConfigurationError(
                device,
                f"{url} is also used by {', '.join(sorted(others))}, "
                "and it is not known that starting one axis leaves the others alone",
                "use a line for each axis, or verify it and set go_starts_all_axes: false",
                ("port",),
            )
        users[device] = _User(axis, alone)
        _ports[key] = (port, users)
        return port


def release(device: str, port: Port) -> None:
    """Give a line back; the last axis closes it."""
    with _ports_lock:
        for key, (known, users) in list(_ports.items()):
            if known is port:
                users.pop(device, None)
                if not users:
                    del _ports[key]
                    port.close()
