"""The clock of the simulated world: real time, faster than real time, or moved by hand.

All twins of one world share one clock, so that what the projector shows, where the stages are and when the
camera exposes are times of one and the same scale. Besides telling the time a clock runs calls at a time
(`call_at`): that is how a twin raises an edge or ends a pattern without a thread of its own.
"""

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from typing import Protocol


class Alarm:
    """A call that a clock will make; `cancel` takes it back."""

    def __init__(self, time_s: float, function: Callable[[], None]) -> None:
        self.time_s = time_s
        self._function: Callable[[], None] | None = function

    def cancel(self) -> None:
        """Take the call back; without effect once it was made."""
        self._function = None

    @property
    def pending(self) -> bool:
        """Whether the call is still to be made."""
        return self._function is not None

    def ring(self) -> None:
        """Make the call, once."""
        function, self._function = self._function, None
        if function is not None:
            function()


class WorldClock(Protocol):
    """What a twin needs of a clock."""

    def now(self) -> float:
        """Return the world's time in seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for a span of the world's time."""
        ...

    def call_at(self, time_s: float, function: Callable[[], None]) -> Alarm:
        """Call a function at a time of the world, or at once (from the clock) if that time is over."""
        ...


class Clock:
    """The machine's monotonic clock, from zero on, `time_scale` times as fast.

    Calls are made by one thread of the clock's own, which starts with the first `call_at` and ends with
    `close`. A called function must not block: every other alarm of the world waits behind it.

    Parameters
    ----------
    time_scale
        Seconds of the world a real second.

    Raises
    ------
    ValueError
        If `time_scale` is not positive.
    """

    def __init__(self, time_scale: float = 1.0) -> None:
        if not 0 < time_scale < float("inf"):
            raise ValueError(f"time_scale must be positive and finite, not {time_scale}")
        self.time_scale = time_scale
        self._origin_s = time.monotonic()
        self._alarms: list[tuple[float, int, Alarm]] = []
        self._order = itertools.count()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False

    def now(self) -> float:
        """Return the world's time in seconds."""
        return (time.monotonic() - self._origin_s) * self.time_scale

    def sleep(self, seconds: float) -> None:
        """Wait for a span of the world's time."""
        if seconds > 0:
            time.sleep(seconds / self.time_scale)

    def call_at(self, time_s: float, function: Callable[[], None]) -> Alarm:
        """Call a function from the clock's thread at a time of the world; at once if that time is over."""
        alarm = Alarm(time_s, function)
        with self._changed:
            if self._closed:
                alarm.cancel()
                return alarm
            heapq.heappush(self._alarms, (time_s, next(self._order), alarm))
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="world-clock", daemon=True)
                self._thread.start()
            self._changed.notify()
        return alarm

    def close(self) -> None:
        """Drop all alarms and end the clock's thread; time itself goes on."""
        with self._changed:
            self._closed = True
            self._alarms.clear()
            self._changed.notify()
            thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._closed and (not self._alarms or self._alarms[0][0] > self.now()):
                    wait_s = (self._alarms[0][0] - self.now()) / self.time_scale if self._alarms else None
                    self._changed.wait(wait_s)
                if self._closed:
                    return
                alarm = heapq.heappop(self._alarms)[2]
            alarm.ring()


class ManualClock:
    """A clock that stands still until someone moves it: `advance` makes the calls that fall due, in order.

    `sleep` moves the clock, for nobody else would: a twin that takes its time takes none of the test's.
    """

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s
        self._alarms: list[tuple[float, int, Alarm]] = []
        self._order = itertools.count()
        self._lock = threading.Lock()

    def now(self) -> float:
        """Return the world's time in seconds."""
        return self._now_s

    def sleep(self, seconds: float) -> None:
        """Move the clock on by a span of time."""
        if seconds > 0:
            self.advance(seconds)

    def call_at(self, time_s: float, function: Callable[[], None]) -> Alarm:
        """Call a function from the thread that moves the clock to that time, or on from a later one."""
        alarm = Alarm(time_s, function)
        with self._lock:
            heapq.heappush(self._alarms, (time_s, next(self._order), alarm))
        return alarm

    def advance(self, seconds: float) -> None:
        """Move the clock on by `seconds`; 0 makes the calls that are due."""
        with self._lock:
            end_s = self._now_s + seconds
        while (alarm := self._next_alarm(end_s)) is not None:
            # Outside the lock: the called function may ask for the time or set another alarm.
            alarm.ring()

    def _next_alarm(self, end_s: float) -> Alarm | None:
        with self._lock:
            if not self._alarms or self._alarms[0][0] > end_s:
                self._now_s = max(self._now_s, end_s)
                return None
            time_s, _, alarm = heapq.heappop(self._alarms)
            self._now_s = max(self._now_s, time_s)
            return alarm
