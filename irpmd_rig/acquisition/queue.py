"""Runs that wait for the rig, in their order, and whether the next one may start by itself.

The queue is durable because it is not kept here: a run that waits says so, with its place, in the last line of its
`state.jsonl`. What is not durable is the leave to start, and that is on purpose: after every start of the daemon
and after every run that did not succeed, a person has to give it again.
"""

from __future__ import annotations

import threading

STARTED = "the daemon was started"


class RunQueue:
    """Order of the waiting runs; safe to use from any thread. It begins held."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._orders: dict[str, int] = {}
        self._last_order = 0
        self._why = STARTED
        self._fresh = False

    def next_order(self) -> int:
        """Return a place behind all that were ever given."""
        with self._lock:
            self._last_order += 1
            return self._last_order

    def seen(self, order: int | None) -> None:
        """Take note of a place that was given earlier, so that it is never given again."""
        with self._lock:
            self._last_order = max(self._last_order, order or 0)

    def add(self, run_id: str, order: int) -> None:
        """Let a run wait at its place."""
        self.seen(order)
        with self._lock:
            self._orders[run_id] = order

    def remove(self, run_id: str) -> None:
        """Take a run out, whether it waits or not."""
        with self._lock:
            self._orders.pop(run_id, None)

    def waiting(self) -> tuple[str, ...]:
        """Runs in their order."""
        with self._lock:
            return tuple(sorted(self._orders, key=self._orders.__getitem__))

    def first(self) -> str | None:
        """Return the run that is next; None: none waits."""
        return next(iter(self.waiting()), None)

    def hold(self, why: str) -> None:
        """Let no run start by itself, and say why."""
        with self._lock:
            self._why = why
            self._fresh = False

    def resume(self) -> None:
        """Give leave to start."""
        with self._lock:
            self._why = ""
            self._fresh = True

    def leave_used(self) -> None:
        """Take note that a run starts."""
        with self._lock:
            self._fresh = False

    @property
    def leave_is_fresh(self) -> bool:
        """Whether leave was given and no run has started since: only then one may that needs an operator."""
        with self._lock:
            return self._fresh

    @property
    def why_held(self) -> str:
        """Why it is held; empty when it is not."""
        with self._lock:
            return self._why
