"""The checkerboard: unbiased corners, poses that fix a camera, a board that lies on the plate."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from sims.boards import board_corners_mm, board_on_plate_pose, board_pose, plate_pose
from sims.camera_rays import project
from sims.errors import SimulationError, WorldError
from sims.rig import SimulatedRig
from sims.world import World, load_world


@pytest.fixture(scope="module")
def full(worlds: Path) -> World:
    return load_world(worlds / "aligned.yaml")


def corners_px(world: World, pose: int) -> np.ndarray:
    place = board_pose(world, pose)
    return project(world.camera, place.centre_mm + board_corners_mm(world.board) @ place.axes)


def refined(frame: np.ndarray, corners: np.ndarray) -> np.ndarray:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = corners.reshape(-1, 1, 2).astype(np.float32)
    return cv2.cornerSubPix(frame, start, (7, 7), (-1, -1), criteria).reshape(-1, 2)


@pytest.mark.parametrize("pose", [0, 4])
def test_rendered_corners_are_where_the_truth_says(full: World, pose: int) -> None:
    rig = SimulatedRig(full)
    rig.set_glass(False)
    rig.set_lamp(True)
    rig.place("board", pose=pose)
    truth = corners_px(full, pose).reshape(-1, 2)
    error = refined(rig.capture(), truth) - truth
    assert np.sqrt((error**2).mean()) < 0.03
    assert np.abs(error.mean(axis=0)).max() < 0.005


def test_all_corners_are_visible_and_together_they_reach_the_image_corners(full: World) -> None:
    pixels = np.concatenate([corners_px(full, pose).reshape(-1, 2) for pose in range(full.board.poses)])
    margin = full.board.margin_px
    assert pixels.min() > margin
    assert pixels.max() < 2047 - margin
    for corner in ((0, 0), (2047, 0), (0, 2047), (2047, 2047)):
        assert np.linalg.norm(pixels - corner, axis=1).min() < 2048 / 6
    cells = np.histogram2d(*pixels.T, bins=8, range=[[0, 2048], [0, 2048]])[0]
    assert np.all(cells > 0)


def test_poses_are_tilted_as_the_world_says_and_drawn_from_its_seed(full: World) -> None:
    axes = [board_pose(full, pose).axes for pose in range(full.board.poses)]
    tilts = np.degrees([np.arccos(-one[2, 2]) for one in axes])
    assert full.board.tilt_deg[0] - 1e-9 <= tilts.min()
    assert 35 < tilts.max() <= full.board.tilt_deg[1]
    assert all(np.abs(one @ one.T - np.eye(3)).max() < 1e-14 and np.linalg.det(one) > 0 for one in axes)
    other = full.model_copy(update={"seed": 2})
    assert not np.allclose(board_pose(other, 3).centre_mm, board_pose(full, 3).centre_mm)
    assert np.array_equal(board_pose(full, 3).axes, board_pose(full, 3).axes)


def test_board_on_plate_lies_in_the_plates_surface(full: World) -> None:
    stage2 = full.stage2.model_copy(update={"plate_tilt_about_y_deg": 1.5, "axis_tilt_about_x_deg": 0.5})
    world = full.model_copy(update={"stage2": stage2})
    for position in (0.0, 120.0):
        plate, board = plate_pose(world, position), board_on_plate_pose(world, position)
        corners = board.centre_mm + board_corners_mm(world.board) @ board.axes
        assert np.abs((corners - plate.centre_mm) @ plate.axes[2]).max() < 1e-12
    assert plate_pose(full, 10.0).centre_mm == pytest.approx([0, 0, 223.0])


def test_rendered_board_on_plate_has_its_corners_at_the_present_position(full: World) -> None:
    rig = SimulatedRig(full)
    rig.set_glass(False)
    rig.set_lamp(True)
    rig.place("board_on_plate")
    rig.move_stage2(100.0)
    place = board_on_plate_pose(full, rig.setup.stage2_mm)
    truth = project(full.camera, place.centre_mm + board_corners_mm(full.board) @ place.axes).reshape(-1, 2)
    error = refined(rig.capture(), truth) - truth
    # Rows along the pixels' rows: OpenCV's own sub-pixel bias is largest there.
    assert np.sqrt((error**2).mean()) < 0.04
    assert np.abs(error.mean(axis=0)).max() < 0.01


def test_opencv_finds_the_board(full: World) -> None:
    rig = SimulatedRig(full)
    rig.set_glass(False)
    rig.set_lamp(True)
    rig.place("board", pose=7)
    columns, rows = full.board.squares
    found, _ = cv2.findChessboardCorners(rig.capture(), (columns - 1, rows - 1))
    assert found


def test_mean_albedo_of_a_pixel_is_that_of_the_pixels_it_holds(ideal: World) -> None:
    coarse, fine = SimulatedRig(ideal), SimulatedRig(ideal.with_camera_size(1024))
    for rig in (coarse, fine):
        rig.place("board", pose=4)
    seen = coarse.trace()
    held = fine.trace().lamp_factor.reshape(256, 4, 256, 4).mean(axis=(1, 3))
    inside = binary_erosion(seen.kind == 2, iterations=3)
    assert inside.sum() > 5000
    assert np.abs(seen.lamp_factor - held)[inside].max() < 2e-3


def test_impossible_pose_is_refused(full: World) -> None:
    with pytest.raises(SimulationError, match="poses 0 to 29"):
        board_pose(full, 30)
    near = full.board.model_copy(update={"distance_mm": (80.0, 90.0)})
    with pytest.raises(WorldError, match="no pose 0 fits"):
        board_pose(full.model_copy(update={"board": near}), 0)
