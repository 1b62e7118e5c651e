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


# Eight pixels of weight 1 for every value of a byte: a row's first pixel is the lowest bit of its first byte.
_PIXELS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little").view(np.uint64)[:, 0]


# As many as a burst shows.
@lru_cache(maxsize=32)
def _compose(planes: tuple[bytes, ...]) -> Image:
    # Eight pixels at a time: no bit leaves its byte, for there are at most eight planes.
    eights = np.zeros(PLANE_BYTES, np.uint64)
    for weight, plane in enumerate(planes):
        eights |= (_PIXELS << np.uint64(weight))[np.frombuffer(plane, np.uint8)]
    image: Image = eights.view(np.uint8).reshape(ROWS, COLUMNS)
    full = (1 << len(planes)) - 1
    if full < 255:
        image = ((np.arange(full + 1) * 255 + full // 2) // full).astype(np.uint8)[image]
    image.setflags(write=False)
    return image
