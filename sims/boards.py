"""Where the checkerboard is: free poses drawn from the world's seed, or lying on the plate."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sims.camera_rays import project
from sims.errors import SimulationError, WorldError
from sims.frames import Matrix, Vector, turn

if TYPE_CHECKING:
    from sims.instruments import Board, Camera
    from sims.world import World

# Places in the image, in thirds, that the free poses visit in turn: corners fix the distortion, so they come
# most.
_CORNERS = ((-1, -1), (1, 1), (-1, 1), (1, -1))
_EDGES = ((-1, 0), (1, 0), (0, -1), (0, 1))
_PLACES = (*_CORNERS, (0, 0), *_EDGES, *_CORNERS, (0, 0))
# A pinhole sees a body's front: its z axis points back at the camera, so that x right leaves y up.
_FACING = np.diag([1.0, -1.0, -1.0])
_TRIES = 200
_ROUNDS = 100
_CLOSE_PX = 1e-3


@dataclass(frozen=True, slots=True)
class FlatPose:
    """A flat body in the camera's frame (as that is at stage1 = 0): its axes are rows, z is its front."""

    centre_mm: Vector
    axes: Matrix


def plate_pose(world: "World", stage2_mm: float) -> FlatPose:
    """Pose the plate when stage2 is displaced by `stage2_mm`."""
    stage = world.stage2
    travel = turn(stage.axis_tilt_about_x_deg, stage.axis_tilt_about_y_deg)[:, 2]
    surface = turn(stage.plate_tilt_about_x_deg, stage.plate_tilt_about_y_deg)
    return FlatPose(np.array([0.0, 0.0, stage.start_mm]) + stage2_mm * travel, _FACING @ surface.T)


def board_on_plate_pose(world: "World", stage2_mm: float) -> FlatPose:
    """Pose the board lying on the plate: its plane is the plate's surface."""
    plate = plate_pose(world, stage2_mm)
    x, y = world.board.on_plate_centre_mm
    angle = math.radians(world.board.on_plate_turn_deg)
    return FlatPose(plate.centre_mm + x * plate.axes[0] + y * plate.axes[1], _turned(angle) @ plate.axes)


def board_pose(world: "World", pose: int) -> FlatPose:
    """One of the board's free poses, in front of the camera.

    Raises
    ------
    SimulationError
        There is no such pose.
    WorldError
        The world's ranges leave no room for the board in the image.
    """
    board, camera = world.board, world.camera
    if not 0 <= pose < board.poses:
        raise SimulationError(f"the board has poses 0 to {board.poses - 1}, not {pose}")
    generator = np.random.default_rng([world.seed, 0xB0A2D, pose])
    outline = _outline(board)
    for _ in range(_TRIES):
        tilt, azimuth = math.radians(generator.uniform(*board.tilt_deg)), generator.uniform(0, 2 * math.pi)
        in_plane = math.radians(generator.uniform(*board.turn_deg))
        # A tilt about the direction `azimuth` of the image plane.
        about = _turned(azimuth)
        lean = about.T @ turn(math.degrees(tilt), 0.0) @ about
        axes = _turned(in_plane) @ _FACING @ lean.T
        centre = np.array([0.0, 0.0, generator.uniform(*board.distance_mm)])
        place = np.array(_PLACES[pose % len(_PLACES)], dtype=np.float64)
        place[place == 0] += generator.uniform(-0.3, 0.3, 2)[place == 0]
        if _settle(camera, outline @ axes, centre, board.margin_px, place):
            return FlatPose(centre, axes)
    raise WorldError(f"board: in {_TRIES} tries no pose {pose} fits into the image with its margin")


def board_corners_mm(board: "Board") -> NDArray[np.float64]:
    """Inner corners (rows, columns, 3) in the board's frame: x grows along a row, y against the rows."""
    columns, rows = board.squares
    x = (np.arange(1, columns) - columns / 2) * board.square_mm
    y = (rows / 2 - np.arange(1, rows)) * board.square_mm
    return np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), np.zeros((rows - 1, columns - 1))], axis=-1)


def _turned(angle: float) -> Matrix:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _outline(board: "Board") -> NDArray[np.float64]:
    """Points around the chequered part, close enough that the lens bends nothing out between them."""
    half = np.array(board.squares) * board.square_mm / 2
    t = np.linspace(-1, 1, 9)
    one = np.ones_like(t)
    xy = np.concatenate([np.stack(p, 1) for p in ((t, -one), (t, one), (-one, t), (one, t))]) * half
    return np.column_stack([xy, np.zeros(len(xy))])


def _settle(
    camera: "Camera", outline: NDArray[np.float64], centre: Vector, margin: float, place: NDArray[np.float64]
) -> bool:
    """Move a board sideways until it lies in the image at `place` (-1: touching the low margin, 1: the high one).

    Returns
    -------
    Whether it fits; `centre` is changed in place.
    """
    size = np.array(camera.size_px)
    for _ in range(_ROUNDS):
        points = centre + outline
        if points[:, 2].min() <= 0:
            return False
        pixels = project(camera, points)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        room = size - 2 * margin - (high - low)
        if room.min() < 0:
            return False
        # The image begins half a pixel before the centre of its first pixel.
        shift = margin - 0.5 + room * (0.5 + 0.5 * place) - low
        if np.abs(shift).max() < _CLOSE_PX:
            return True
        centre[:2] += shift * centre[2] / np.array(camera.fc_px)
    return False
