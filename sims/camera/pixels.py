"""Pixel formats: how a frame's pixels lie in memory (GenICam pixel format naming convention, PFNC 2.3)."""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Image = NDArray[np.uint8] | NDArray[np.uint16]


def _plain(image: Image, lines: Bytes) -> None:
    bytes_of_image = image.view(np.uint8)
    np.copyto(lines[:, : bytes_of_image.shape[1]], bytes_of_image)


@numba.njit(cache=True, nogil=True)
def _mono10p(image: Image, lines: Bytes) -> None:
    """Four pixels in five bytes: a stream of 10-bit words, least significant bit first."""
    for row in range(image.shape[0]):
        for group in range(image.shape[1] // 4):
            first, second = image[row, 4 * group], image[row, 4 * group + 1]
            third, fourth = image[row, 4 * group + 2], image[row, 4 * group + 3]
            lines[row, 5 * group] = first & 0xFF
            lines[row, 5 * group + 1] = first >> 8 | second << 2 & 0xFF
            lines[row, 5 * group + 2] = second >> 6 | third << 4 & 0xFF
            lines[row, 5 * group + 3] = third >> 4 | fourth << 6 & 0xFF
            lines[row, 5 * group + 4] = fourth >> 2


@numba.njit(cache=True, nogil=True)
def _mono10_packed(image: Image, lines: Bytes) -> None:
    """Two pixels in three bytes: the outer ones hold the upper eight bits, the middle one the lowest two."""
    for row in range(image.shape[0]):
        for pair in range(image.shape[1] // 2):
            left, right = image[row, 2 * pair], image[row, 2 * pair + 1]
            lines[row, 3 * pair] = left >> 2
            lines[row, 3 * pair + 1] = left & 3 | (right & 3) << 4
            lines[row, 3 * pair + 2] = right >> 2


def _compiled(kernel: Callable[[Image, Bytes], None]) -> Callable[[Image, Bytes], None]:
    def pack(image: Image, lines: Bytes) -> None:
        # One kind of array only: each other one would be compiled anew, in the middle of a stream.
        kernel(np.require(image, requirements=["C", "W"]), lines)

    return pack


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A pixel format: its PFNC name and value, significant bits, bits that a pixel takes in memory."""

    name: str
    value: int
    bits: int
    bits_per_pixel: int
    _pack: Callable[[Image, Bytes], None]

    def line_bytes(self, width: int) -> int:
        """Bytes of a line of `width` pixels (a multiple of 4), without padding."""
        return width * self.bits_per_pixel // 8

    def pack(self, image: Image, memory: Bytes, padding: int) -> None:
        """Write `image` (H, W), uint8 for 8 bits else uint16, to the beginning of `memory`.

        Each line is followed by `padding` bytes, which are left as they are.
        """
        height, width = image.shape
        size = self.line_bytes(width) + padding
        self._pack(image, memory[: height * size].reshape(height, size))

    def prepare(self) -> None:
        """Compile what packs this format, so that no frame waits for it."""
        self.pack(np.zeros((1, 4), np.uint8 if self.bits == 8 else np.uint16), np.zeros(8, np.uint8), 0)


FORMATS = (
    PixelFormat("Mono8", 0x01080001, 8, 8, _plain),
    PixelFormat("Mono10", 0x01100003, 10, 16, _plain),
    PixelFormat("Mono10p", 0x010A0046, 10, 10, _compiled(_mono10p)),
    PixelFormat("Mono10Packed", 0x010C0004, 10, 12, _compiled(_mono10_packed)),
)
"""What the camera offers; whether an xiQ calls its packed format Mono10p or Mono10Packed is not verified."""


def response(bits: int, gain_db: float, gamma: float) -> Image | None:
    """Table that applies gain and gamma to values of `bits` bits; None where both leave them as they are."""
    if gain_db == 0 and gamma == 1:
        return None
    full = (1 << bits) - 1
    share = np.minimum(np.arange(full + 1) / full * 10 ** (gain_db / 20), 1.0)
    table = np.rint(full * share ** (1 / gamma))
    return table.astype(np.uint8) if bits == 8 else table.astype(np.uint16)
