import numpy as np
import pytest

from irpmd_rig.core.errors import CountsError, FramesError
from irpmd_rig.core.fringes import fringe_images
from irpmd_rig.core.phase import decode


def test_default_images_are_the_papers_three_sets_of_four_steps():
    images = fringe_images()
    assert images.shape == (3, 4, 768, 1024)
    assert images.dtype == np.uint8
    assert images.flags.c_contiguous


def test_phase_at_a_column_and_step_follow_the_formula():
    images = fringe_images(counts=(7, 2.5), steps=5, size_px=(40, 3))
    for k, count in enumerate((7, 2.5)):
        for n in range(5):
            for x in range(40):
                phase = 2 * np.pi * count * (x + 0.5) / 40 + 2 * np.pi * n / 5
                assert abs(int(images[k, n, 1, x]) - (127 + 127 * np.cos(phase))) <= 0.5 + 1e-9


def test_axis_y_is_axis_x_turned():
    x = fringe_images(size_px=(64, 48), axis="x")
    y = fringe_images(size_px=(48, 64), axis="y")
    np.testing.assert_array_equal(y, np.swapaxes(x, 2, 3))


@pytest.mark.parametrize("bits", range(1, 9))
def test_fewer_bits_show_fewer_levels_over_the_same_range(bits):
    levels = np.unique(fringe_images(counts=(1,), size_px=(4096, 1), bits=bits))
    assert levels[0] == 0
    assert levels[-1] == 254
    assert levels.size == min(2**bits, 255)


def test_the_images_themselves_decode_over_the_whole_projector_without_a_saturated_pixel():
    absolute = decode(fringe_images(), (64, 63, 56))
    truth = 2 * np.pi * 64 * (np.arange(1024) + 0.5) / 1024
    assert absolute.valid.all()
    # What is left is the rounding of the pattern to whole levels.
    assert np.abs(absolute.phase_rad - truth).max() < 0.006


@pytest.mark.parametrize(
    "counts",
    [
        *[(), (0,), (-1, 2), (np.nan,), (np.inf,), (1e308,), (10**400,), (16385,)],
        *[(True,), (1j,), ("64",), ((1, 2), (3,))],
        *["abc", {64: 1}, {64}, None, 64, np.array(64), np.ones((1, 2)), np.ma.array([64, 63], mask=[0, 1])],
    ],
)
def test_impossible_counts_are_refused(counts):
    with pytest.raises(CountsError, match="above 0"):
        fringe_images(counts=counts)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"steps": 2}, "at least 3"),
        ({"steps": 4.0}, "integer"),
        ({"steps": 10**9}, "at most 1000"),
        ({"size_px": (0, 4)}, "width, height"),
        ({"size_px": 5}, "width, height"),
        ({"size_px": None}, "width, height"),
        ({"size_px": {8: 1, 4: 1}}, "width, height"),
        ({"size_px": (10**9, 10**9)}, "1 to 16384"),
        ({"size_px": (16384, 16384), "steps": 1000}, "4 GiB"),
        ({"axis": np.array(["x", "y"])}, "'x' or 'y'"),
        ({"axis": None}, "'x' or 'y'"),
        ({"size_px": (4,)}, "width, height"),
        ({"axis": "z"}, "'x' or 'y'"),
        ({"bits": 0}, "1 to 8"),
        ({"bits": 9}, "1 to 8"),
    ],
)
def test_impossible_images_are_refused(wrong, says):
    with pytest.raises(FramesError, match=says):
        fringe_images(**wrong)
