import numpy as np
import pytest
from fringe_reference import columns, fringes

from irpmd_rig.core.errors import CalibrationError, FramesError
from irpmd_rig.core.phase import CameraResponse, decode

POINTS = ([1.5, 40.0, 130.25, 240.0], [0.0, 60.0, 150.0, 255.0])


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32", ">u2", ">f4"])
def test_values_between_the_points_lie_on_straight_lines_and_those_outside_take_the_ends(kind):
    values = np.arange(256).reshape(16, 16).astype(kind)
    linear = CameraResponse(*POINTS).apply(values)
    assert linear.dtype == np.float32
    np.testing.assert_allclose(linear, np.interp(values.astype(float), *POINTS), rtol=1e-6)


def test_a_response_cannot_be_changed_afterwards():
    camera = np.array(POINTS[0])
    response = CameraResponse(camera, POINTS[1])
    camera[0] = 99
    assert response.camera_values[0] == 1.5
    with pytest.raises(ValueError, match="read-only"):
        response.camera_values[0] = 99
    with pytest.raises(AttributeError):
        response.camera_values = camera


@pytest.mark.parametrize(
    ("camera", "linear", "says"),
    [
        ([0], [0], "at least 2"),
        ("abc", [0, 1], "camera_values .* list of numbers"),
        ([0, 1], [0, [1, 2]], "linear_values .* list of numbers"),
        ([0, 1, 2], [0, 1], "same length"),
        ([[0, 1]], [[0, 1]], "1-D"),
        ([0, np.nan], [0, 1], "finite"),
        ([0, 0, 1], [0, 1, 2], "increase strictly"),
        ([0, 1, 2], [0, 2, 1], "never decrease"),
        ([0, 1, 2], [1, 1, 1], "never decrease"),
    ],
)
def test_points_that_are_no_response_are_refused(camera, linear, says):
    with pytest.raises(CalibrationError, match=says):
        CameraResponse(camera, linear)


def test_frames_of_another_type_are_refused():
    with pytest.raises(FramesError, match="uint8, uint16 or float32, got float64"):
        CameraResponse(*POINTS).apply(np.zeros(3))


@pytest.mark.parametrize("threads", [1, 3])
def test_saturation_is_judged_before_the_response(threads):
    """The last points may be flat: what is saturated cannot be told from the linear values."""
    frames = np.rint(fringes((64, 63, 56), columns(300, 500), 4, 120, 100)).astype(np.uint8)
    frames[0, 1, 450, 7] = 255
    frames[0, 1, 450, 9] = 254
    flat_end = CameraResponse([0, 200, 255], [0, 1, 1])
    options = {"response": flat_end, "threads": threads, "min_modulation_dn": 0.01}
    absolute = decode(frames, (64, 63, 56), **options)
    assert not absolute.valid[450, 7]
    assert np.isnan(absolute.phase_rad[450, 7])
    assert (~absolute.valid).sum() <= 2
    assert absolute.modulation_dn.max() < 1


def test_decoding_through_a_response_is_decoding_the_linear_values():
    frames = np.rint(fringes((64, 63, 56), columns(301, 40), 5, 120, 100)).astype(np.uint8)
    response = CameraResponse(*POINTS)
    through = decode(frames, (64, 63, 56), response=response, min_modulation_dn=10)
    direct = decode(response.apply(frames), (64, 63, 56), min_modulation_dn=10)
    np.testing.assert_array_equal(through.phase_rad, direct.phase_rad)
    np.testing.assert_array_equal(through.modulation_dn, direct.modulation_dn)
