"""Grey images as the bit planes of the LightCommander's pattern memory.

TI's API takes one plane a call: 98 304 bytes, the rows from the top down, each of 128 bytes, with the pixel
x = 0 in bit 0 of a row's first byte.
"""

import numpy as np
from numpy.typing import NDArray

COLUMNS, ROWS = 1024, 768
PLANE_BYTES = COLUMNS * ROWS // 8
PLANES = 960


def pack(image: NDArray[np.uint8], bits: int) -> list[bytes]:
    """Return the planes of an image, that of the lowest bit first.

    Parameters
    ----------
    image
        (768, 1024), full scale 255.
    bits
        Bits per pixel that are kept: the upper ones.
    """
    values = image >> (8 - bits)
    return [np.packbits(values & 1 << bit, axis=1, bitorder="little").tobytes() for bit in range(bits)]
