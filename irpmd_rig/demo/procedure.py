"""The paper's procedure on the simulated rig: calibration from scratch, then a measurement."""

from __future__ import annotations

from collections.abc import Callable
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
from irpmd_rig.demo.capture import Frame, Photographer, grow, shrink

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


def calibrate(photographer: Photographer, drawing: Drawing, announce: Announce) -> Calibration:
    """Calibrate from scratch: 30 boards, 21 plates, sprayed mirror with glass, reference at both positions."""
    announce("checkerboard in 30 poses: the camera's intrinsics")
    board = photographer.rig.world.board
    chequered = Checkerboard((board.squares[1] - 1, board.squares[0] - 1), board.square_mm)
    camera = calibrate_camera(_board_images(photographer), chequered, threads=photographer.threads)
    directions = rays(camera.intrinsics)
    announce("white plate at 21 positions: absolute phase to depth")
    relation = fit_plate_relation(_plate_phases(photographer), PLATE_POSITIONS_MM, threads=photographer.threads)
    on_plate = next(board for board in camera.boards if board.view == BOARDS - 1)
    announce("sprayed mirror, glass and reference at both stage positions: planes, angles, distance")
    regions = _find_regions(photographer)
    phases = _mirror_phases(photographer)
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


def measure(photographer: Photographer, calibration: Calibration, subject: str, announce: Announce) -> Measurement:
    """Measure the object ``subject`` by the depth equation at the two stage positions."""
    rig = photographer.rig
    rig.place(subject)
    rig.set_glass(True)
    frames, phases = [], []
    for position in STAGE_POSITIONS_MM:
        announce(f"{subject} at stage position {position:g} mm")
        rig.move_stage1(position)
        photographer.expose(photographer.white())
        frames.append(photographer.fringes())
        phases.append(photographer.decode(frames[-1]))
    references = [reference.phase_rad for reference in calibration.references]
    depth = direct_depth(
        *references,
        *(phase.phase_rad for phase in phases),
        d_mm=calibration.geometry.d_mm,
        delta_d_mm=STAGE_POSITIONS_MM[1] - STAGE_POSITIONS_MM[0],
    ).astype(np.float64)
    points = calibration.geometry.frame.points_mm(depth, calibration.rays)
    return Measurement(frames[0], tuple(phases), depth, points)


def _board_images(photographer: Photographer) -> list[Frame]:
    """One frame of the board in each pose; the last pose lies on the white plate."""
    rig = photographer.rig
    rig.set_glass(False)
    rig.set_lamp(True)
    images = []
    for pose in range(BOARDS):
        if pose < BOARDS - 1:
            rig.place("board", pose=pose)
        else:
            rig.move_stage2(BOARD_ON_PLATE_AT_MM)
            rig.place("board_on_plate")
        photographer.expose(None)
        images.append(photographer.frame(None))
        photographer.tick(1)
    rig.set_lamp(False)
    return images


def _plate_phases(photographer: Photographer) -> NDArray[np.float32]:
    rig = photographer.rig
    rig.place("plate")
    maps = []
    for position in PLATE_POSITIONS_MM:
        rig.move_stage2(position)
        photographer.expose(photographer.white())
        maps.append(photographer.decode(photographer.fringes()).phase_rad)
    return np.stack(maps)


@dataclass(frozen=True, slots=True)
class _Regions:
    """Where the camera sees the sprayed mirror, and the glass directly at each stage position."""

    sprayed: NDArray[np.bool_]
    glass: tuple[NDArray[np.bool_], ...]


def _find_regions(photographer: Photographer) -> _Regions:
    """Find the regions by taking things away: the mirror alone, then the glass alone."""
    rig = photographer.rig
    rig.move_stage1(STAGE_POSITIONS_MM[0])
    rig.place("mirror")
    rig.set_glass(False)
    photographer.expose(photographer.white())
    sprayed = photographer.lit()
    rig.place("nothing")
    rig.set_glass(True)
    glass = []
    for position in STAGE_POSITIONS_MM:
        rig.move_stage1(position)
        photographer.expose(photographer.white())
        glass.append(photographer.lit())
    return _Regions(sprayed, tuple(glass))


def _mirror_phases(photographer: Photographer) -> tuple[AbsolutePhase, ...]:
    rig = photographer.rig
    rig.place("mirror")
    phases = []
    for position in STAGE_POSITIONS_MM:
        rig.move_stage1(position)
        photographer.expose(photographer.white())
        phases.append(photographer.decode(photographer.fringes()))
    return tuple(phases)
