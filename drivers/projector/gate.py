"""What every projector driver has in common: one operation at a time, stopped from any thread, and what it checks."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from drivers.errors import Refused
from drivers.values import PatternSequence

NOT_OPEN = ("the projector is not open", "open it first")


class Gate:
    """Lets one operation in at a time, and knows whether `stop` was called since it began."""

    def __init__(self, device: str) -> None:
        self._device = device
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._beginning = threading.Lock()
        self._stops = 0

    @contextmanager
    def operation(self) -> Iterator[None]:
        """Hold the gate; Refused if another operation is under way, or a stop."""
        with self._beginning:
            if self._stops:
                raise Refused(self._device, "it is being stopped", "begin again when that is over")
            if not self._lock.acquire(blocking=False):
                raise Refused(self._device, "another operation is under way", "wait for its end, or stop it")
            self._stopped.clear()
        try:
            yield
        finally:
            self._lock.release()

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """End the operation that is under way at its next step, and let none begin meanwhile."""
        with self._beginning:
            self._stops += 1
            self._stopped.set()
        try:
            yield
        finally:
            with self._beginning:
                self._stops -= 1

    def drain(self, timeout_s: float) -> None:
        """Wait, after `stop`, until no operation is under way."""
        if self._lock.acquire(timeout=timeout_s):
            self._lock.release()

    def check(self) -> None:
        """Raise Refused if the operation was stopped."""
        if self._stopped.is_set():
            raise self._ended()

    def pause(self, seconds: float) -> None:
        """Wait; Refused if the operation was stopped."""
        if seconds > 0.0 and self._stopped.wait(seconds):
            raise self._ended()

    def _ended(self) -> Refused:
        return Refused(self._device, "the operation was stopped", "begin it again")


def check_patterns(
    device: str, patterns: NDArray[np.uint8], size_px: tuple[int, int], limit: int | None
) -> NDArray[np.uint8]:
    """Pass patterns on as an array of their own.

    Raises
    ------
    Refused
        Not (n, H, W) of uint8 in this projector's size, none at all, or more than `limit`.
    """
    width, height = size_px
    if patterns.dtype != np.uint8 or patterns.ndim != 3 or patterns.shape[1:] != (height, width):
        raise Refused(
            device,
            f"patterns of shape {patterns.shape} and type {patterns.dtype} do not fit",
            f"give (n, {height}, {width}) of uint8",
        )
    if not len(patterns) or (limit is not None and len(patterns) > limit):
        raise Refused(device, f"{len(patterns)} patterns do not fit", f"give 1 to {limit or 'any number of'} patterns")
    return np.array(patterns, order="C")


def check_sequence(device: str, sequence: PatternSequence, count: int) -> None:
    """Check what holds for every projector.

    Raises
    ------
    Refused
        Nothing in the order, an index that is not loaded, or times or bits that cannot be.
    """
    if not sequence.order:
        raise Refused(device, "the order is empty", "name at least one pattern")
    if not 1 <= sequence.bits <= 8:
        raise Refused(device, f"{sequence.bits} bits per pixel", "give 1 to 8")
    if not 0.0 < sequence.exposure_us < 1e9:
        raise Refused(device, f"an exposure of {sequence.exposure_us:g} us", "give a positive one")
    period_us = sequence.period_us
    if period_us is not None and not sequence.exposure_us <= period_us < 1e9:
        raise Refused(
            device,
            f"a period of {period_us:g} us for an exposure of {sequence.exposure_us:g} us",
            "give at least the exposure",
        )
    for index in sequence.order:
        check_index(device, index, count)


def check_index(device: str, index: int, count: int) -> None:
    """Raise Refused if pattern `index` is not among the `count` that are loaded."""
    if not 0 <= index < count:
        loaded = f"0 to {count - 1} are" if count else "none is"
        raise Refused(device, f"pattern {index} is not loaded", f"load it first: {loaded} there")
