"""Bit planes as a LightCommander keeps them, turned back into images."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sims.projector.player import Image

ROWS, COLUMNS = 768, 1024
PLANE_BYTES = ROWS * COLUMNS // 8
PLANES = 960


@dataclass(frozen=True, slots=True)
class PlanePattern:
    """The planes of one image, that of least weight first."""

    planes: tuple[bytes, ...]

    def image(self) -> Image:
        """Return the grey values, 0 to 255, as a read-only array of shape (768, 1024)."""
        return _compose(self.planes)


@lru_cache(maxsize=8)
def _compose(planes: tuple[bytes, ...]) -> Image:
    values = np.zeros((ROWS, COLUMNS), np.uint16)
    for weight, plane in enumerate(planes):
        # A row's first pixel is the lowest bit of its first byte.
        bits = np.unpackbits(np.frombuffer(plane, np.uint8), bitorder="little").reshape(ROWS, COLUMNS)
        values += bits.astype(np.uint16) << weight
    full = (1 << len(planes)) - 1
    image = ((values.astype(np.uint32) * 255 + full // 2) // full).astype(np.uint8)
    image.setflags(write=False)
    return image
