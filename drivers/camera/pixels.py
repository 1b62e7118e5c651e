"""Pixel formats of the GenICam pixel format naming convention, and their unpacking to plain arrays."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Packing = Literal["none", "lsb", "grouped"]

_ROWS_AT_ONCE = 64


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """How pixels lie in memory.

    Attributes
    ----------
    code
        Number in the convention, as buffers carry it.
    bits
        Significant bits of a value.
    packing
        ``"none"``: whole bytes, little endian. ``"lsb"`` (a name that ends in p): bits without gaps, the lowest
        first. ``"grouped"`` (Packed): two pixels in three bytes, the low bits of both in the middle one.
    """

    name: str
    code: int
    bits: int
    channels: int = 1
    packing: Packing = "none"

    @property
    def kind(self) -> np.dtype[Any]:
        """Type of the unpacked values."""
        return np.dtype(np.uint8 if self.bits == 8 else np.dtype("<u2"))

    @property
    def group_px(self) -> int:
        """Pixels that fill whole bytes together: a line holds a multiple of it."""
        return {"none": 1, "grouped": 2, "lsb": 4}[self.packing]

    def line_bytes(self, width_px: int) -> int:
        """Size of a line without padding."""
        if self.packing == "none":
            return width_px * self.channels * self.kind.itemsize
        return width_px * (12 if self.packing == "grouped" else self.bits) // 8

    def shape(self, width_px: int, height_px: int) -> tuple[int, ...]:
        """Shape of the unpacked image."""
        return (height_px, width_px) if self.channels == 1 else (height_px, width_px, self.channels)


_FORMATS = (
    PixelFormat("Mono8", 0x01080001, 8),
    PixelFormat("Mono10", 0x01100003, 10),
    PixelFormat("Mono10p", 0x010A0046, 10, packing="lsb"),
    PixelFormat("Mono10Packed", 0x010C0004, 10, packing="grouped"),
    PixelFormat("Mono12", 0x01100005, 12),
    PixelFormat("Mono12p", 0x010C0047, 12, packing="lsb"),
    PixelFormat("Mono12Packed", 0x010C0006, 12, packing="grouped"),
    PixelFormat("Mono14", 0x01100025, 14),
    PixelFormat("Mono16", 0x01100007, 16),
    PixelFormat("RGB8", 0x02180014, 8, channels=3),
    PixelFormat("BGR8", 0x02180015, 8, channels=3),
    PixelFormat("RGBa8", 0x02200016, 8, channels=4),
    PixelFormat("BGRa8", 0x02200017, 8, channels=4),
)
BY_NAME = {form.name: form for form in _FORMATS}
BY_CODE = {form.code: form for form in _FORMATS}


def unpack(
    data: NDArray[np.uint8], form: PixelFormat, *, width_px: int, height_px: int, padding_bytes: int, out: NDArray[Any]
) -> None:
    """Copy an image into `out`, without line padding, one value an element.

    Parameters
    ----------
    data
        The buffer, at least ``height_px * (form.line_bytes(width_px) + padding_bytes)`` bytes.
    out
        Contiguous, of the format's shape and type.

    Raises
    ------
    ValueError
        The buffer is too small, or a line does not end at a whole byte.
    """
    line_bytes = form.line_bytes(width_px)
    stride = line_bytes + padding_bytes
    if width_px % form.group_px:
        raise ValueError(f"{form.name} needs a width that is a multiple of {form.group_px}")
    if padding_bytes < 0 or data.size < height_px * stride:
        raise ValueError(f"{data.size} bytes are too few for {width_px} x {height_px} pixels of {form.name}")
    lines = data[: height_px * stride].reshape(height_px, stride)
    if form.packing == "none":
        np.copyto(out.reshape(height_px, -1).view(np.uint8), lines[:, :line_bytes])
        return
    fill = _unpack_lsb if form.packing == "lsb" else _unpack_grouped
    for first in range(0, height_px, _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        fill(lines[rows], form, out[rows])


def _unpack_lsb(lines: NDArray[np.uint8], form: PixelFormat, out: NDArray[Any]) -> None:
    """Spread the four pixels of a group over a word of 64 bits: first two and two, then one and one."""
    bits, group_bytes = form.bits, form.bits // 2
    groups = out.size // 4
    packed = np.zeros(groups * group_bytes + 8, np.uint8)
    packed[:-8].reshape(len(lines), -1)[:] = lines[:, : form.line_bytes(out.shape[1])]
    words = out.reshape(-1).view(np.uint64)
    # Each word begins at its group and reaches into the next: what is too much is masked.
    np.copyto(words, np.ndarray((groups,), "<u8", packed, 0, (group_bytes,)))
    pair, single = (1 << 2 * bits) - 1, (1 << bits) - 1
    upper = words << np.uint64(32 - 2 * bits)
    upper &= np.uint64(pair << 32)
    words &= np.uint64(pair)
    words |= upper
    np.bitwise_and(words, np.uint64((single | single << 32) << bits), out=upper)
    upper <<= np.uint64(16 - bits)
    words &= np.uint64(single | single << 32)
    words |= upper


def _unpack_grouped(lines: NDArray[np.uint8], form: PixelFormat, out: NDArray[Any]) -> None:
    groups = lines[:, : form.line_bytes(out.shape[1])].reshape(len(lines), -1, 3)
    low_bits = form.bits - 8
    mask = (1 << low_bits) - 1
    middle = groups[:, :, 1]
    for lane, (high, shift) in enumerate(((0, 0), (2, 4))):
        pixels = out[:, lane::2]
        np.left_shift(groups[:, :, high], low_bits, out=pixels, dtype=pixels.dtype)
        pixels |= middle >> shift & mask
