"""Unpacking of pixel formats: bytes written by hand, and any picture packed bit by bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.pixels import BY_CODE, BY_NAME, PixelFormat, unpack


def unpacked(data: bytes, name: str, width: int, height: int, padding: int = 0):
    form = BY_NAME[name]
    out = np.zeros(form.shape(width, height), form.kind)
    unpack(np.frombuffer(data, np.uint8), form, width_px=width, height_px=height, padding_bytes=padding, out=out)
    return out


def test_golden_bytes():
    # Pixels 0x3FF, 0x000, 0x155, 0x2AA: 40 bits, the lowest first.
    assert unpacked(bytes([0xFF, 0x03, 0x50, 0x95, 0xAA]), "Mono10p", 4, 1).tolist() == [[0x3FF, 0, 0x155, 0x2AA]]
    # Pixels 0x2A5, 0x13E: eight high bits, both low bits, eight high bits.
    assert unpacked(bytes([0xA9, 0x21, 0x4F]), "Mono10Packed", 2, 1).tolist() == [[0x2A5, 0x13E]]
    assert unpacked(bytes([0xBC, 0x3A, 0x12, 0xFF, 0x0F, 0x00]), "Mono12p", 4, 1).tolist() == [[0xABC, 0x123, 0xFFF, 0]]
    assert unpacked(bytes([0xAB, 0x3C, 0x12]), "Mono12Packed", 2, 1).tolist() == [[0xABC, 0x123]]
    assert unpacked(bytes([0x01, 0x02, 0xFF, 0x03]), "Mono10", 2, 1).tolist() == [[0x201, 0x3FF]]
    assert unpacked(bytes(range(8)), "RGBa8", 2, 1).tolist() == [[[0, 1, 2, 3], [4, 5, 6, 7]]]


def packed(values: list[int], form: PixelFormat) -> bytes:
    """One line, bit by bit."""
    if form.packing == "lsb":
        bits = "".join(format(value, f"0{form.bits}b")[::-1] for value in values)
        return bytes(int(bits[i : i + 8][::-1], 2) for i in range(0, len(bits), 8))
    if form.packing == "grouped":
        low = form.bits - 8
        pairs = zip(values[::2], values[1::2], strict=True)
        return b"".join(bytes([a >> low, a & (1 << low) - 1 | (b & (1 << low) - 1) << 4, b >> low]) for a, b in pairs)
    return b"".join(value.to_bytes(form.kind.itemsize, "little") for value in values)


@given(
    form=st.sampled_from([form for form in BY_NAME.values() if form.channels == 1]),
    groups=st.integers(1, 5),
    height=st.integers(1, 130),
    padding=st.sampled_from([0, 1, 8]),
    seed=st.integers(0, 1000),
)
def test_any_picture_comes_out_as_it_was_packed(form, groups, height, padding, seed):
    width = groups * form.group_px
    picture = np.random.default_rng(seed).integers(0, 1 << form.bits, (height, width))
    data = b"".join(packed(line.tolist(), form) + b"\xa5" * padding for line in picture)
    assert (unpacked(data + b"\xff" * 3, form.name, width, height, padding) == picture).all()


def test_a_buffer_that_is_too_small_is_refused():
    with pytest.raises(ValueError, match="too few"):
        unpacked(bytes(9), "Mono10p", 4, 2)
    with pytest.raises(ValueError, match="multiple of 4"):
        unpacked(bytes(90), "Mono10p", 6, 2)
    with pytest.raises(ValueError, match="too few"):
        unpacked(bytes(90), "Mono8", 4, 2, padding=-1)


def test_codes_are_those_of_the_convention():
    # From the convention: bits that a pixel takes are in bits 16 to 23 of its number.
    for code, form in BY_CODE.items():
        assert code >> 16 & 0xFF == 8 * form.line_bytes(4) // 4
    assert BY_NAME["Mono10p"].code == 0x010A0046
