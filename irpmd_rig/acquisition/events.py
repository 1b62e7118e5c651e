"""What happens in the rig, numbered and kept for a while; no reader, however slow, holds anybody up."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from types import MappingProxyType
from typing import Any

KEPT_EVENTS = 4096
GAP = "gap"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes
    ----------
    id
        Grows by one from event to event, and from one start of the daemon to the next: the number that a reader
        names to go on after it.
    time_s
        Seconds since 1970-01-01 UTC.
    kind
        ``"state"``, ``"progress"``, ``"prompt"``, ``"frame"``, ``"rig"``, ``"queue"``, ``"lease"``, ``"stop"``;
        or ``"gap"``: events before this one are no longer kept and were missed (``data["missed"]``: how many of all
        runs; None where nobody can tell).
    run_id
        The run that it concerns; None: the rig.
    data
        JSON values.
    """

    id: int
    time_s: float
    kind: str
    run_id: str | None
    data: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


class EventLog:
    """The latest events, for any number of readers.

    All readers share one bounded ring and each has only a place in it. One that falls behind by more than the
    ring holds is told of the gap and goes on with the oldest event that is left; whoever announces an event
    never waits for a reader.

    Parameters
    ----------
    kept
        Number of events that are kept.
    clock
        Seconds since 1970.
    """

    def __init__(self, kept: int = KEPT_EVENTS, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._events: deque[Event] = deque(maxlen=kept)
        # Milliseconds as the first id: a new start of the daemon then goes on above the ids of the last one.
        self._next_id = int(clock() * 1000)
        self._changed = threading.Condition()
        self._waking: set[Callable[[], None]] = set()
        self._closed = False

    def announce(self, kind: str, run_id: str | None = None, /, **data: Any) -> Event:
        """Add an event; returns it with its id."""
        with self._changed:
            event = Event(self._next_id, self._clock(), kind, run_id, MappingProxyType(data))
            self._next_id += 1
            self._events.append(event)
            waking = tuple(self._waking)
            self._changed.notify_all()
        for wake in waking:
            wake()
        return event

    def subscribe(
        self, after_id: int | None = None, run_id: str | None = None, wake: Callable[[], None] | None = None
    ) -> Subscription:
        """Read events from now on, or again from after the event `after_id`.

        Parameters
        ----------
        after_id
            Last event that the reader has seen; None: only what comes.
        run_id
            Only events of this run.
        wake
            Called, from whatever thread announces, after each new event and at the end: for a reader that does
            not block. It must return at once and not raise.
        """
        with self._changed:
            if wake is not None:
                self._waking.add(wake)
            return Subscription(self, self._next_id - 1 if after_id is None else after_id, run_id, wake)

    def close(self) -> None:
        """End all subscriptions once they have read what is there."""
        with self._changed:
            self._closed = True
            waking = tuple(self._waking)
            self._changed.notify_all()
        for wake in waking:
            wake()

    # --- for Subscription

    def _after(self, last_id: int) -> tuple[list[Event], bool]:
        """Events after `last_id`, a gap notice first where some are missing; and whether more may come."""
        last = self._next_id - 1
        kept = len(self._events)
        if 0 < last - last_id <= kept:
            return list(islice(self._events, kept - (last - last_id), None)), not self._closed
        if last_id == last:
            return [], not self._closed
        # Before what is kept, or an id that this log never gave: nobody can tell what was missed.
        first_id = self._events[0].id if self._events else self._next_id
        missed = first_id - last_id - 1 if last_id < last else None
        gap = Event(first_id - 1, self._clock(), GAP, None, MappingProxyType({"missed": missed}))
        return [gap, *self._events], not self._closed

    def _wait(self, last_id: int, timeout_s: float | None) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._next_id - 1 != last_id, timeout_s)

    def _forget(self, wake: Callable[[], None]) -> None:
        with self._changed:
            self._waking.discard(wake)


class Subscription:
    """One reader's place in an `EventLog`; iterate over it, or `take` what is there. Close it at the end."""

    def __init__(self, log: EventLog, last_id: int, run_id: str | None, wake: Callable[[], None] | None) -> None:
        self._log = log
        self._last_id = last_id
        self._run_id = run_id
        self._wake = wake

    def take(self) -> list[Event] | None:
        """Take the events that came since the last call; None when there will be no more. Never waits."""
        with self._log._changed:
            events, more = self._log._after(self._last_id)
        if not events:
            return [] if more else None
        self._last_id = events[-1].id
        return [event for event in events if self._run_id is None or event.run_id == self._run_id or event.kind == GAP]

    def wait(self, timeout_s: float | None = None) -> list[Event] | None:
        """Take as `take` does, but wait for up to `timeout_s` (None: without end) for something to come."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            taken = self.take()
            left_s = None if deadline_s is None else deadline_s - time.monotonic()
            if taken is None or taken or (left_s is not None and left_s <= 0.0):
                return taken
            self._log._wait(self._last_id, left_s)

    def __iter__(self) -> Iterator[Event]:
        while (events := self.wait()) is not None:
            yield from events

    def close(self) -> None:
        """Forget this reader; may be repeated."""
        if self._wake is not None:
            self._log._forget(self._wake)
            self._wake = None

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
