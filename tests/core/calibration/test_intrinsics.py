"""Camera intrinsics from images of a checkerboard."""

import cv2
import numpy as np
import pytest

from irpmd_rig.core.calibration.intrinsics import (
    Checkerboard,
    calibrate_camera,
    find_corners,
    neighbours_excess,
)
from irpmd_rig.core.errors import CalibrationError, FramesError

SIZE = 640
FOCAL, CENTRE = 736.0, (318.0, 321.0)
MATRIX = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1.0]])
BOARD = Checkerboard()
TEXTURE_PX = 24  # a square of the drawn board


def texture():
    rows, columns = BOARD.inner_corners[0] + 1, BOARD.inner_corners[1] + 1
    squares = np.indices((rows, columns)).sum(axis=0) % 2
    drawn = np.kron(squares, np.ones((TEXTURE_PX, TEXTURE_PX))) * 190 + 30
    return np.pad(drawn, TEXTURE_PX, constant_values=220).astype(np.uint8)


def board_image(rotation_deg, distance_mm, shift_mm=(0.0, 0.0)):
    """A view of the board and its true inner corners."""
    rotation = cv2.Rodrigues(np.deg2rad(np.array(rotation_deg, dtype=np.float64)))[0]
    points = BOARD.points_mm.astype(np.float64)
    middle = points.mean(axis=0)
    origin = np.array([*shift_mm, distance_mm]) - rotation @ middle
    camera = points @ rotation.T + origin
    truth = (camera @ MATRIX.T)[:, :2] / camera[:, 2:]
    rows, columns = BOARD.inner_corners
    in_texture = np.stack(np.mgrid[:rows, :columns][::-1], -1).reshape(-1, 2) * TEXTURE_PX + 2 * TEXTURE_PX - 0.5
    # Drawn four times finer and averaged: edges are grey where they cut a pixel.
    fine = 4
    homography, _ = cv2.findHomography(in_texture, (truth + 0.5) * fine - 0.5)
    drawn = cv2.warpPerspective(
        texture(), homography, (SIZE * fine, SIZE * fine), flags=cv2.INTER_LINEAR, borderValue=60
    )
    image = cv2.GaussianBlur(cv2.resize(drawn, (SIZE, SIZE), interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    noise = np.random.default_rng(7).normal(0, 1.0, image.shape)
    return np.clip(np.round(image + noise), 0, 255).astype(np.uint8), truth


POSES = [
    ((0, 0, 2), 300, (0, 0)),
    ((32, 5, 0), 330, (30, 20)),
    ((-30, 8, 12), 330, (-30, 25)),
    ((6, 34, -8), 330, (25, -30)),
    ((-4, -33, 20), 330, (-25, -25)),
    ((25, 25, 45), 360, (0, 0)),
    ((-25, 22, 80), 360, (10, 0)),
    ((20, -28, -35), 360, (0, 10)),
]


def farthest(found, truth):
    """Largest distance of a true corner to the nearest found one: a board has no first corner of its own."""
    return np.linalg.norm(found.reshape(-1, 1, 2) - truth, axis=-1).min(axis=0).max()


def test_corners_to_a_few_hundredths_of_a_pixel():
    for pose in POSES[:4]:
        image, truth = board_image(*pose)
        assert farthest(find_corners(image, BOARD), truth) < 0.12
        ten_bits = find_corners(image.astype(np.uint16) * 4, BOARD)
        assert farthest(ten_bits, truth) < 0.12


def test_focal_length_and_centre_within_their_stated_uncertainty():
    result = calibrate_camera([board_image(*pose)[0] for pose in POSES], threads=2)
    for value, sigma in zip(result.intrinsics.focal_px, result.sigma_focal_px, strict=True):
        assert abs(value - FOCAL) < 4 * sigma + 0.1
    for value, truth, sigma in zip(
        result.intrinsics.principal_point_px, CENTRE, result.sigma_principal_point_px, strict=True
    ):
        assert abs(value - truth) < 4 * sigma + 0.1
    assert max(result.pixel_error_px) < 0.08
    assert result.missed_views == ()
    assert result.boards[0].centre_mm[2] == pytest.approx(300, abs=0.3)
    assert result.intrinsics.distortion[4] == 0


def test_a_picture_without_a_board_is_named_and_left_out():
    images = [board_image(*pose)[0] for pose in POSES[:4]]
    images.insert(1, np.full((SIZE, SIZE), 128, np.uint8))
    result = calibrate_camera(images)
    assert result.missed_views == (1,)
    assert [board.view for board in result.boards] == [0, 2, 3, 4]


def test_what_cannot_be_calibrated_is_said():
    flat = np.full((SIZE, SIZE), 128, np.uint8)
    with pytest.raises(CalibrationError, match="found in 0 of 3 images"):
        calibrate_camera([flat] * 3)
    parallel = [board_image((0, 0, turn), 320)[0] for turn in (0, 5, 10)]
    with pytest.raises(CalibrationError, match="parallel"):
        calibrate_camera(parallel)
    with pytest.raises(FramesError, match="differ in size"):
        calibrate_camera([flat, flat[:100]])
    with pytest.raises(FramesError, match="uint8 or uint16"):
        find_corners(np.zeros((5, 5, 3), np.uint8), BOARD)
    for odd in (None, [None] * 3, ["a"] * 3, [np.zeros((1, 1), np.uint8)] * 3):
        with pytest.raises(FramesError):
            calibrate_camera(odd)
    with pytest.raises(CalibrationError, match="3 x 3"):
        Checkerboard((2, 5), 10.0)


def test_independent_corner_errors_are_not_inflated_and_such_that_hang_together_are():
    rng = np.random.default_rng(0)
    white = rng.standard_normal((200, 13, 11, 2))
    factors = [neighbours_excess(one) for one in white]
    assert np.median(factors) == 1
    assert max(factors) < 3
    together = [neighbours_excess(cv2.GaussianBlur(one, (0, 0), 1.5, borderType=cv2.BORDER_REFLECT)) for one in white]
    assert np.median(together) > 5


def test_the_tilt_of_a_board_along_the_pixels_is_as_unsure_as_it_says():
    others = [board_image(*pose)[0] for pose in POSES[1:]]
    scores = []
    for distance_mm in (295, 310, 325, 340, 355, 370):
        calibration = calibrate_camera([*others, board_image((0, 0, 0), distance_mm)[0]], threads=2)
        board = calibration.boards[-1]
        scores.append(board.rotation[:2, 2] / board.sigma_tilt_rad)
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 1.1
