"""Frames as other people hold them: any size, layout, type; and what is refused."""

import dataclasses

import numpy as np
import pytest
from fringe_reference import columns, fringes

from irpmd_rig.core.errors import CountsError, FramesError, MeasurementError
from irpmd_rig.core.phase import AbsolutePhase, CameraResponse, decode, wrapped_phases

COUNTS = (64, 63, 56)
KINDS = ["uint8", "uint16", "float32"]


def scene(kind="uint8", height=37, width=203, steps=4, counts=COUNTS):
    rng = np.random.default_rng(2)
    frames = fringes(counts, columns(width, height), steps)
    return np.rint(frames + rng.normal(0, 1.5, frames.shape)).astype(kind)


def assert_same(one, other):
    for name in ("phase_rad", "modulation_dn", "valid"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def in_file_order(frames):
    """As many tools store them: (H, W, frames)."""
    flat = np.moveaxis(frames.reshape(-1, *frames.shape[2:]), 0, 2).copy()
    return np.moveaxis(flat, 2, 0).reshape(frames.shape)


def unaligned(frames):
    raw = np.zeros(frames.nbytes + 1, np.uint8)
    shifted = raw[1:].view(frames.dtype).reshape(frames.shape)
    shifted[:] = frames
    return shifted


def read_only(frames):
    frames = frames.copy()
    frames.flags.writeable = False
    return frames


LAYOUTS = {
    "Fortran order": np.asfortranarray,
    "frames last": in_file_order,
    "every other column": lambda f: np.repeat(f, 2, axis=3)[..., ::2],
    "cropped rows and columns": lambda f: np.pad(f, ((0, 0), (0, 0), (2, 3), (4, 5)))[..., 2:-3, 4:-5],
    "backwards": lambda f: f[::-1, ::-1, ::-1, ::-1].copy()[::-1, ::-1, ::-1, ::-1],
    "some of the steps": lambda f: np.repeat(f, 2, axis=1)[:, ::2],
    "big-endian": lambda f: f.astype(f.dtype.newbyteorder(">")),
    "unaligned": unaligned,
    "read-only": read_only,
    "nested lists of frames": lambda f: [list(frames_of_set) for frames_of_set in f],
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_layout_in_memory_does_not_matter(layout, kind):
    frames = scene(kind)
    assert_same(decode(LAYOUTS[layout](frames), COUNTS), decode(frames, COUNTS))
    np.testing.assert_array_equal(wrapped_phases(LAYOUTS[layout](frames)).phase_rad, wrapped_phases(frames).phase_rad)


def test_frames_may_be_a_memory_map(tmp_path):
    frames = scene("uint16")
    frames.tofile(tmp_path / "frames.raw")
    mapped = np.memmap(tmp_path / "frames.raw", np.uint16, "r", shape=frames.shape)
    assert_same(decode(mapped, COUNTS), decode(frames, COUNTS))


def test_frames_are_left_as_they_were():
    frames = scene()
    before = frames.copy()
    decode(frames, COUNTS)
    np.testing.assert_array_equal(frames, before)
    assert frames.flags.writeable


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 2), (7, 13), (3, 5000), (5000, 3), (1, 70001)])
@pytest.mark.parametrize("steps", [3, 4, 7, 8])
def test_any_size_decodes(size, steps):
    height, width = size
    position = np.random.default_rng(6).uniform(0.001, 0.999, size)
    frames = np.rint(fringes(COUNTS, position, steps)).astype(np.uint8)
    for given in (frames, np.asfortranarray(frames)):
        absolute = decode(given, COUNTS)
        assert absolute.valid.shape == (height, width)
        assert absolute.valid.all()
        np.testing.assert_allclose(absolute.phase_rad, 2 * np.pi * 64 * position, atol=0.02)


@pytest.mark.parametrize("threads", [2, 3, 64])
@pytest.mark.parametrize("arranged", [np.ascontiguousarray, np.asfortranarray])
@pytest.mark.parametrize(("steps", "counts", "how"), [(4, COUNTS, "optimum"), (5, (1, 8, 64), "hierarchical")])
def test_threads_do_not_change_a_bit(threads, arranged, steps, counts, how):
    frames = arranged(scene(height=211, width=1013, steps=steps, counts=counts))
    one = decode(frames, counts, unwrapping=how)
    assert_same(decode(frames, counts, unwrapping=how, threads=threads), one)


def test_an_earlier_result_lends_its_memory():
    frames, others = scene(), scene()[:, :, ::-1, ::-1]
    earlier = decode(others, COUNTS)
    again = decode(frames, COUNTS, out=earlier)
    assert np.shares_memory(again.phase_rad, earlier.phase_rad)
    assert_same(again, decode(frames, COUNTS))
    with pytest.raises(MeasurementError, match=r"out is a result of shape \(37, 203\).*\(9, 203\)"):
        decode(frames[:, :, :9], COUNTS, out=earlier)


@pytest.mark.parametrize(
    ("name", "array", "says"),
    [
        ("phase_rad", np.zeros((37, 100), np.float32), "shape"),
        ("modulation_dn", np.zeros(37 * 203, np.float32), "shape"),
        ("valid", np.zeros((203, 37), np.bool_), "shape"),
        ("phase_rad", np.zeros((37, 203)), "float32, got float64"),
        ("modulation_dn", np.zeros((37, 203), ">f4"), "float32, got >f4"),
        ("valid", np.zeros((37, 203), np.uint8), "bool.*, got uint8"),
        ("phase_rad", np.zeros((203, 37), np.float32).T, "C-contiguous"),
        ("valid", read_only(np.zeros((37, 203), np.bool_)), "writeable"),
        ("phase_rad", unaligned(np.zeros((37, 203), np.float32)), "aligned"),
        ("modulation_dn", None, "array"),
    ],
)
def test_an_earlier_result_that_cannot_be_overwritten_is_refused(name, array, says):
    earlier = dataclasses.replace(decode(scene(), COUNTS), **{name: array})
    with pytest.raises(MeasurementError, match=says):
        decode(scene(), COUNTS, out=earlier)


@pytest.mark.parametrize("out", [{}, "earlier", np.zeros((37, 203), np.float32)])
def test_only_a_result_lends_its_memory(out):
    with pytest.raises(MeasurementError, match="out must be a result of decode"):
        decode(scene(), COUNTS, out=out)


@pytest.mark.parametrize("given", [lambda f: f, list, lambda f: [list(s) for s in f]])
def test_masked_values_are_refused_and_an_empty_mask_is_none(given):
    frames = np.ma.array(scene())
    assert_same(decode(given(frames), COUNTS), decode(scene(), COUNTS))
    frames[1, 2, 3, 4] = np.ma.masked
    for call in (lambda f: decode(f, COUNTS), wrapped_phases):
        with pytest.raises(FramesError, match="fill them or drop the mask"):
            call(given(frames))


@pytest.mark.parametrize("response", ["gamma", 2.2, ([0, 255], [0, 1]), CameraResponse])
def test_a_response_of_another_type_is_refused(response):
    for call in (lambda r: decode(scene(), COUNTS, response=r), lambda r: wrapped_phases(scene(), response=r)):
        with pytest.raises(MeasurementError, match="response must be a CameraResponse"):
            call(response)


def test_the_result_is_typed_and_frozen():
    absolute = decode(scene(), COUNTS)
    assert isinstance(absolute, AbsolutePhase)
    assert absolute.phase_rad.dtype == absolute.modulation_dn.dtype == absolute.sigma_rad.dtype == np.float32
    assert absolute.valid.dtype == np.bool_
    assert absolute.phase_rad.shape == absolute.sigma_rad.shape == (37, 203)
    assert (absolute.counts, absolute.steps, absolute.unwrapping) == ((64.0, 63.0, 56.0), 4, "optimum")
    with pytest.raises(AttributeError):
        absolute.steps = 3


@pytest.mark.parametrize(
    ("frames", "says"),
    [
        (np.zeros((12, 8, 8), np.uint8), r"shape \(sets, steps, H, W\), got \(12, 8, 8\)"),
        (np.zeros((3, 2, 8, 8), np.uint8), "at least 3 phase steps, got 2"),
        (np.zeros((3, 4, 0, 8), np.uint8), "at least one set and one pixel"),
        (np.zeros((3, 4, 8, 8), np.float64), "uint8, uint16 or float32, got float64"),
        (np.zeros((3, 4, 8, 8), np.int16), "got int16"),
        ([[[[1], [1, 2]]]], "one array"),
    ],
)
def test_frames_that_cannot_be_decoded_are_refused(frames, says):
    with pytest.raises(FramesError, match=says):
        decode(frames, COUNTS)
    with pytest.raises(FramesError, match=says):
        wrapped_phases(frames)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e35])
@pytest.mark.parametrize("arranged", [np.ascontiguousarray, np.asfortranarray])
def test_values_that_are_no_numbers_are_refused_with_their_place(bad, arranged):
    frames = scene("float32")
    frames[1, 2, 3, 4] = bad
    frames[2, 0, 0, 0] = bad
    for call in (lambda f: decode(f, COUNTS), wrapped_phases):
        with pytest.raises(FramesError, match=r"2 values .* set 1, step 2, row 3, column 4"):
            call(arranged(frames))


@pytest.mark.parametrize("response", [None, CameraResponse([0, 4095], [0, 1])])
def test_a_value_above_ten_bits_asks_for_the_saturation(response):
    frames = scene("uint16") * np.uint16(16)
    with pytest.raises(FramesError, match=r"above 1023.*pass saturation_dn"):
        decode(frames, COUNTS, response=response)
    assert decode(frames, COUNTS, response=response, saturation_dn=4095).valid.all()


@pytest.mark.parametrize(
    ("counts", "how", "says"),
    [
        ((64, 63), "optimum", "2 fringe counts .* 3 sets"),
        ((64, 62, 56), "optimum", "one count below the finest.*hierarchical"),
        ((64, 63, 56.5), "optimum", "whole fringe counts.*hierarchical"),
        ((64, 64, 63), "optimum", "differ"),
        ((64, 63, 0), "optimum", "above 0"),
        ((64, 63, np.nan), "optimum", "above 0"),
        ("abc", "optimum", "above 0"),
        (("64", "63", "56"), "optimum", "above 0"),
        ((8, 7, True), "optimum", "above 0"),
        ((64, 63, 56j), "optimum", "above 0"),
        (((64, 63), 56, 1), "optimum", "above 0"),
        ({64: 0, 63: 0, 56: 0}, "optimum", "above 0"),
        (None, "optimum", "above 0"),
        ((1e308, 64, 1), "hierarchical", "at most 16384"),
        ((1.1, 4, 16), "hierarchical", "at most 1 period"),
    ],
)
def test_impossible_counts_are_refused(counts, how, says):
    with pytest.raises(CountsError, match=says):
        decode(scene(), counts, unwrapping=how)


def test_one_set_alone_is_for_hierarchical_unwrapping_only():
    frames = scene()[:1]
    with pytest.raises(CountsError, match="at least 2 sets"):
        decode(frames, (64,))
    position = columns(203, 37)
    frames = np.rint(fringes((1,), position, 4)).astype(np.uint8)
    absolute = decode(frames, (1,), unwrapping="hierarchical")
    np.testing.assert_allclose(absolute.phase_rad, 2 * np.pi * position, atol=0.02)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"unwrapping": "spatial"}, "'optimum' or 'hierarchical'"),
        ({"unwrapping": np.array(["optimum", "optimum"])}, "'optimum' or 'hierarchical'"),
        ({"threads": 0}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"threads": True}, "threads"),
        ({"saturation_dn": 0}, "saturation_dn"),
        ({"saturation_dn": np.nan}, "saturation_dn"),
        *[({"saturation_dn": bad}, "saturation_dn") for bad in ("255", True, 255j, [255], np.inf, -1, 1e300)],
        *[({"min_modulation_dn": bad}, "min_modulation_dn") for bad in ("9", True, 9j, [9], np.inf, 1e300)],
        ({"min_modulation_dn": -1}, "min_modulation_dn"),
        ({"min_modulation_dn": np.nan}, "min_modulation_dn"),
    ],
)
def test_impossible_options_are_refused(options, says):
    with pytest.raises(MeasurementError, match=says):
        decode(scene(), COUNTS, **options)
