"""The paper's procedure on the simulated rig: calibration from scratch, then a measurement."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import (
    AbsolutePhase,
    CameraCalibration,
    Checkerboard,
    Drawing,
    PlateRelation,
    RigGeometry,
    SmoothPhase,
    calibrate_camera,
    calibrate_geometry,
    direct_depth,
    fit_plate_relation,
    place_plate,
    rays,
    smooth_reference,
)
from irpmd_rig.demo.capture import Decoded, Frame, Lab, grow, shrink

COUNTS = (64.0, 63.0, 56.0)
STEPS = 4
BOARDS = 30
PLATE_POSITIONS_MM = tuple(float(p) for p in range(0, 201, 10))
BOARD_ON_PLATE_AT_MM = 100.0
STAGE_POSITIONS_MM = (0.0, 40.0)

_SET = len(COUNTS) * STEPS
# Boards, plates, mirror with glass at both positions, object at both positions; exposures are not counted.
FRAMES = BOARDS + (len(PLATE_POSITIONS_MM) + 4) * _SET

Announce = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a measurement needs, all of it from frames.

    Attributes
    ----------
    camera : CameraCalibration
        Intrinsics and board poses.
    relation : PlateRelation
        Absolute phase to plate position.
    geometry : RigGeometry
        Planes, angles, d and frame M.
    rays : ndarray, (H, W, 3)
        Undistorted rays of the pixels.
    references : tuple of SmoothPhase
        Reference mirror's phase at the two stage positions.
    """

    camera: CameraCalibration
    relation: PlateRelation
    geometry: RigGeometry
    rays: NDArray[np.float64]
    references: tuple[SmoothPhase, ...]


@dataclass(frozen=True, slots=True)
class Measurement:
    """An object's frames, phases and depth.

    Attributes
    ----------
    frames : ndarray, (sets, steps, H, W)
        Of the first stage position.
    phases : tuple of AbsolutePhase
        At the two stage positions.
    depth_mm : ndarray of float64, (H, W)
        Height above the reference plane; NaN where unknown.
    points_mm : ndarray of float64, (H, W, 3)
        The same as points of frame M.
    """

    frames: Frame
    phases: tuple[AbsolutePhase, ...]
    depth_mm: NDArray[np.float64]
    points_mm: NDArray[np.float64]


def calibrate(lab: Lab, board: Checkerboard, drawing: Drawing, announce: Announce) -> Calibration:
    """Calibrate from scratch: 30 boards, 21 plates, sprayed mirror with glass, reference at both positions."""
    announce("checkerboard in 30 poses: the camera's intrinsics")
    camera = calibrate_camera(_board_images(lab), board, threads=lab.threads)
    directions = rays(camera.intrinsics)
    announce("white plate at 21 positions: absolute phase to depth")
    plates = _plate_phases(lab)
    announce("sprayed mirror, glass and reference at both stage positions: planes, angles, distance")
    regions = _find_regions(lab)
    mirror = _phases(lab, "mirror")
    relation = fit_plate_relation(
        np.stack([plate.result().phase.phase_rad for plate in plates]), PLATE_POSITIONS_MM, threads=lab.threads
    )
    on_plate = next(board for board in camera.boards if board.view == BOARDS - 1)
    phases = tuple(decoded.result().phase for decoded in mirror)
    geometry = calibrate_geometry(
        camera,
        relation,
        place_plate(on_plate, BOARD_ON_PLATE_AT_MM),
        phases[0].phase_rad,
        shrink(regions.sprayed),
        shrink(regions.glass[0]),
        rays=directions,
        drawing=drawing,
        board_view=on_plate.view,
    )
    references = tuple(
        smooth_reference(phase.phase_rad, region=~grow(regions.sprayed | glass))
        for phase, glass in zip(phases, regions.glass, strict=True)
    )
    return Calibration(camera, relation, geometry, directions, references)


def measure(lab: Lab, calibration: Calibration, subject: str, announce: Announce) -> Measurement:
    """Measure the object ``subject`` by the depth equation at the two stage positions."""
    announce(f"{subject} at stage positions {', '.join(f'{position:g}' for position in STAGE_POSITIONS_MM)} mm")
    decoded = [future.result() for future in _phases(lab, subject)]
    references = [reference.phase_rad for reference in calibration.references]
    depth = direct_depth(
        *references,
        *(position.phase.phase_rad for position in decoded),
        d_mm=calibration.geometry.d_mm,
        delta_d_mm=STAGE_POSITIONS_MM[1] - STAGE_POSITIONS_MM[0],
    ).astype(np.float64)
    points = calibration.geometry.frame.points_mm(depth, calibration.rays)
    return Measurement(decoded[0].images, tuple(position.phase for position in decoded), depth, points)


def _board_images(lab: Lab) -> list[Frame]:
    """One frame of the board in each pose; the last pose lies on the white plate."""
    images = []
    for pose in range(BOARDS - 1):
        lab.place("board", pose=pose, glass=False, lamp=True)
        images.append(lab.board())
    lab.photographer.move("stage2", BOARD_ON_PLATE_AT_MM)
    lab.place("board_on_plate", glass=False, lamp=True)
    return [*images, lab.board()]


def _plate_phases(lab: Lab) -> list[Future[Decoded]]:
    lab.place("plate", glass=False)
    decoded = []
    for position in PLATE_POSITIONS_MM:
        lab.photographer.move("stage2", position)
        decoded.append(lab.fringes())
    return decoded


@dataclass(frozen=True, slots=True)
class _Regions:
    """Where the camera sees the sprayed mirror, and the glass directly at each stage position."""

    sprayed: NDArray[np.bool_]
    glass: tuple[NDArray[np.bool_], ...]


def _find_regions(lab: Lab) -> _Regions:
    """Find the regions by taking things away: the mirror alone, then the glass alone."""
    lab.photographer.move("stage1", STAGE_POSITIONS_MM[0])
    lab.place("mirror", glass=False)
    sprayed = lab.lit()
    lab.place("nothing")
    glass = []
    for position in STAGE_POSITIONS_MM:
        lab.photographer.move("stage1", position)
        glass.append(lab.lit())
    return _Regions(sprayed, tuple(glass))


def _phases(lab: Lab, subject: str) -> list[Future[Decoded]]:
    """Frames of a subject behind the glass at the two stage positions."""
    lab.place(subject)
    decoded = []
    for position in STAGE_POSITIONS_MM:
        lab.photographer.move("stage1", position)
        decoded.append(lab.fringes())
    return decoded
