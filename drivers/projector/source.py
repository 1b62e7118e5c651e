"""What a projector driver is put together from: a source of patterns, and the line to its box."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InstrumentError
from drivers.values import PatternSequence


def try_each(*calls: Callable[[], None]) -> None:
    """Make each call, whatever became of the ones before it; then raise the first error, if there was one."""
    errors: list[InstrumentError] = []
    for call in calls:
        try:
            call()
        except InstrumentError as error:
            errors.append(error)
    if errors:
        raise errors[0]


class Talking(Protocol):
    """Holds the line of a driver: `PatternProjector._talking`."""

    def __call__(self) -> AbstractContextManager[None]:
        """Enter it."""


class PatternSource(Protocol):
    """Where a projector's patterns come from: its memory, its flash, or its video input."""

    size_px: tuple[int, int]

    def count(self, bits: int, /) -> int:
        """Tell how many patterns of so many bits can be shown."""

    def load(self, patterns: NDArray[np.uint8]) -> None:
        """Replace them by `patterns`, (n, H, W)."""

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Set the sequence, and return it with the times that are in force."""

    def show(self, index: int) -> None:
        """Show one pattern; returns when its light is there."""

    def show_position(self, position: int) -> None:
        """Show the pattern at one position of the order; returns when its light is there."""

    def run(self, *, repeat: bool) -> None:
        """Start the order, once or until `dark`."""

    def dark(self) -> None:
        """Show nothing."""
