"""Patterns of a DLPC350: entries of its look-up table, and the bits that each takes of a 24-bit image."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sims.projector.player import Image

ROWS, COLUMNS = 1140, 912
RgbImage = NDArray[np.uint8]

LED_BITS = ("red", "green", "blue")
EXTERNAL = (1, 2)
NO_PATTERN, FILL = 0x3F, 24
# Shortest exposures at 1 to 8 bits (LightCrafter 4500's table of pattern rates: 4225 Hz to 120 Hz).
SHORTEST_EXPOSURE_US = (235, 700, 1570, 1700, 2000, 2500, 4500, 8333)
# How many patterns an image holds, for the depths whose bits are known here.
PATTERNS = {1: 24, 2: 12, 4: 6, 7: 3, 8: 3}


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of the pattern look-up table, 24 bits."""

    word: int

    @property
    def trigger(self) -> int:
        """What starts it: 0 by itself, 1 and 2 an external edge, 3 it continues the one before."""
        return self.word & 3

    @property
    def number(self) -> int:
        """Which bits of the image it shows."""
        return self.word >> 2 & 0x3F

    @property
    def depth(self) -> int:
        """How many bits it has."""
        return self.word >> 8 & 0xF

    @property
    def leds(self) -> frozenset[str]:
        """The LEDs that it lights."""
        mask = self.word >> 12 & 0x7
        return frozenset(led for bit, led in enumerate(LED_BITS) if mask >> bit & 1)

    @property
    def inverted(self) -> bool:
        """Whether light and dark are exchanged."""
        return bool(self.word >> 16 & 1)

    @property
    def black_after(self) -> bool:
        """Whether a black fill follows it."""
        return bool(self.word >> 17 & 1)

    @property
    def swaps(self) -> bool:
        """Whether the next image of the image table comes with it."""
        return bool(self.word >> 18 & 1)

    @property
    def shares_trigger(self) -> bool:
        """Whether the trigger output stays high from the pattern before."""
        return bool(self.word >> 19 & 1)

    @property
    def valid(self) -> bool:
        """Whether there are such bits."""
        if self.number == NO_PATTERN or (self.depth == 1 and self.number == FILL):
            return True
        return self.number < PATTERNS.get(self.depth, 0)


@dataclass(frozen=True, slots=True)
class BitPattern:
    """An entry with the image that it is taken from."""

    entry: Entry
    source: Callable[[], RgbImage | None]
    inverted: bool

    def image(self) -> Image:
        """Return the grey values, 0 to 255, shape (1140, 912)."""
        depth, number = self.entry.depth, self.entry.number
        values: NDArray[np.uint32]
        rgb = self.source()
        if rgb is None or number == NO_PATTERN:
            return np.zeros((ROWS, COLUMNS), np.uint8)
        if depth == 1 and number == FILL:
            values = np.full((ROWS, COLUMNS), 1, np.uint32)
        elif depth >= 7:
            # Patterns 0, 1, 2 are the upper bits of green, red and blue.
            values = rgb[..., (1, 0, 2)[number]].astype(np.uint32) >> np.uint32(8 - depth)
        else:
            word = rgb.astype(np.uint32) @ np.array([1 << 8, 1, 1 << 16], np.uint32)
            values = word >> np.uint32(depth * number) & np.uint32((1 << depth) - 1)
        full = (1 << depth) - 1
        image: Image = ((values * 255 + full // 2) // full).astype(np.uint8)
        return 255 - image if self.inverted != self.entry.inverted else image


@dataclass(frozen=True, slots=True)
class VideoImage:
    """The video input shown as a picture: the mean of its colours."""

    source: Callable[[], RgbImage | None]

    def image(self) -> Image:
        """Return the grey values, 0 to 255, shape (1140, 912)."""
        rgb = self.source()
        if rgb is None:
            return np.zeros((ROWS, COLUMNS), np.uint8)
        image: Image = rgb.mean(axis=2).round().astype(np.uint8)
        return image
