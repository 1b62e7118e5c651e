"""Pixels in memory, against bytes written by hand from the pixel format naming convention."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from sims.camera.pixels import FORMATS, PixelFormat, response

BY_NAME = {pixel_format.name: pixel_format for pixel_format in FORMATS}


def packed(name: str, image: NDArray[np.uint8] | NDArray[np.uint16], padding: int = 0) -> list[int]:
    pixel_format = BY_NAME[name]
    size = (pixel_format.line_bytes(image.shape[1]) + padding) * image.shape[0]
    memory = np.full(size + 3, 0xEE, np.uint8)
    pixel_format.pack(image, memory, padding)
    assert list(memory[size:]) == [0xEE] * 3
    return memory[:size].tolist()


@pytest.mark.parametrize(
    ("name", "golden"),
    [
        # 0x001, 0x3FF, 0x155, 0x2A0
        ("Mono10", [0x01, 0x00, 0xFF, 0x03, 0x55, 0x01, 0xA0, 0x02]),
        # 40 bits, first pixel lowest: 1010100000 0101010101 1111111111 0000000001
        ("Mono10p", [0x01, 0xFC, 0x5F, 0x15, 0xA8]),
        # upper eight bits, then the two low pairs in bits 0-1 and 4-5, then upper eight bits
        ("Mono10Packed", [0x00, 0x31, 0xFF, 0x55, 0x01, 0xA8]),
    ],
)
def test_ten_bits_as_the_convention_says(name: str, golden: list[int]) -> None:
    assert packed(name, np.array([[0x001, 0x3FF, 0x155, 0x2A0]], np.uint16)) == golden


def test_eight_bits_are_bytes() -> None:
    assert packed("Mono8", np.array([[1, 2, 3, 4], [5, 6, 7, 8]], np.uint8)) == [1, 2, 3, 4, 5, 6, 7, 8]


def test_padding_follows_each_line_and_is_left_alone() -> None:
    image = np.array([[1, 2, 3, 4], [5, 6, 7, 8]], np.uint8)
    assert packed("Mono8", image, padding=2) == [1, 2, 3, 4, 0xEE, 0xEE, 5, 6, 7, 8, 0xEE, 0xEE]


def test_values_carry_their_size() -> None:
    # PFNC: bits 16-23 of a format's value are the bits that a pixel takes.
    assert all(pixel_format.value >> 16 & 0xFF == pixel_format.bits_per_pixel for pixel_format in FORMATS)


for _pixel_format in FORMATS:
    _pixel_format.prepare()


@given(pixel_format=st.sampled_from(FORMATS[2:]), seed=st.integers(0, 1000), left=st.sampled_from((0, 4)))
def test_packed_pixels_can_be_had_back(pixel_format: PixelFormat, seed: int, left: int) -> None:
    whole = np.random.default_rng(seed).integers(0, 1024, (3, 16), np.uint16)
    image = whole[:, left:]
    memory = np.zeros(pixel_format.line_bytes(image.shape[1]) * 3, np.uint8)
    pixel_format.pack(image, memory, 0)
    if pixel_format.name == "Mono10p":
        bits = np.unpackbits(memory, bitorder="little").reshape(-1, 10)
        values = bits @ (1 << np.arange(10))
    else:
        first, middle, last = memory.reshape(-1, 3).astype(int).T
        values = np.stack([first << 2 | middle & 3, last << 2 | middle >> 4 & 3], axis=1)
    assert (values.reshape(image.shape) == image).all()


def test_gain_multiplies_and_saturates() -> None:
    table = response(8, 20 * np.log10(2), 1.0)
    assert table is not None
    assert (table[10], table[200]) == (20, 255)


def test_gamma_keeps_black_and_white() -> None:
    table = response(10, 0.0, 2.0)
    assert table is not None
    assert (table[0], table[256], table[1023]) == (0, round(1023 * (256 / 1023) ** 0.5), 1023)


def test_without_gain_and_gamma_nothing_is_changed() -> None:
    assert response(8, 0.0, 1.0) is None
