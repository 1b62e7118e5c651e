"""Planes of glass and sprayed mirror, their angles and d, from phases that a plain pinhole projector throws."""

import numpy as np
import pytest

from irpmd_rig.core import CameraCalibration, Drawing, Intrinsics, rays
from irpmd_rig.core.calibration.geometry import calibrate_geometry
from irpmd_rig.core.calibration.intrinsics import BoardPose
from irpmd_rig.core.calibration.plate import fit_plate_relation, place_plate
from irpmd_rig.core.errors import CalibrationError

SIZE = 160
CAMERA = Intrinsics((SIZE, SIZE), (185.0, 184.0), (80.0, 79.0), (-0.13, 0.15, 0.0, 0.0, 0.0))
ANGLE = np.deg2rad(37)
AXES = np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, -1, 0], [np.sin(ANGLE), 0, -np.cos(ANGLE)]])
CENTRE = np.array([-160.0, 0.0, 330.0])
PROJECTOR = np.array([80.0, 0.0, 1850.0])
POSITIONS = np.arange(0.0, 201.0, 10.0)
DRAWING = Drawing()
RAYS = rays(CAMERA)


def phase_on_plane(normal, offset):
    """Absolute phase seen on the plane normal . X = offset of frame M, and the points (H, W, 3)."""
    directions = RAYS @ AXES
    reach = (offset - CENTRE @ normal) / (directions @ normal)
    points = CENTRE + reach[..., None] * directions
    slope = (points[..., 0] - PROJECTOR[0]) / (PROJECTOR[2] - points[..., 2])
    return 200.0 + 1820.0 * slope, points


def plate_stack():
    axis = AXES[2]
    maps = []
    for position in POSITIONS:
        point = CENTRE + (213.0 + position) * axis
        maps.append(phase_on_plane(axis, point @ axis)[0])
    return np.stack(maps).astype(np.float32)


def board_pose(z_mm=313.0):
    return BoardPose(0, np.eye(3), np.zeros(3), np.array([0.0, 0.0, z_mm]), 0.012, 5e-5, 0.03)


def camera_calibration(board):
    return CameraCalibration(CAMERA, (0.05, 0.05), (0.1, 0.1), (0.0,) * 5, (0.03, 0.03), (board,), ())


def geometry(glass_normal, d_mm, board=None):
    board = board or board_pose()
    glass_normal = np.asarray(glass_normal) / np.linalg.norm(glass_normal)
    offset = glass_normal @ np.array([125.0, 0.0, d_mm])
    glass_phase, glass_points = phase_on_plane(glass_normal, offset)
    mirror_phase, mirror_points = phase_on_plane(np.array([0.0, 0.0, 1.0]), 0.0)
    glass = (glass_points[..., 0] > 0) & (glass_points[..., 0] < 112) & (np.abs(glass_points[..., 1]) < 100)
    mirror = (mirror_points[..., 0] > -60) & (mirror_points[..., 0] < -12) & ~glass
    phase = np.where(glass, glass_phase, np.where(mirror, mirror_phase, np.nan)).astype(np.float32)
    return calibrate_geometry(
        camera_calibration(board),
        fit_plate_relation(plate_stack(), POSITIONS, order=4),
        place_plate(board, 100.0),
        phase,
        mirror,
        glass,
        rays=RAYS,
        drawing=DRAWING,
        board_view=0,
    )


@pytest.mark.parametrize("tilt_deg", [(0.0, 0.0), (0.3, 0.0), (0.0, -0.5)])
def test_d_and_the_angles_of_a_tilted_glass(tilt_deg):
    about_x, about_y = np.deg2rad(tilt_deg)
    normal = [np.sin(about_y), -np.sin(about_x), np.sqrt(1 - np.sin(about_y) ** 2 - np.sin(about_x) ** 2)]
    result = geometry(normal, 180.0)
    assert result.d_mm == pytest.approx(180.0, abs=0.002)
    assert np.cos(result.alpha_rad) == pytest.approx(np.sin(about_y), abs=2e-5)
    assert np.cos(result.beta_rad) == pytest.approx(-np.sin(about_x), abs=2e-5)
    assert result.gamma_rad == pytest.approx(np.hypot(about_x, about_y), abs=2e-5)
    np.testing.assert_allclose(result.frame.camera_mm, CENTRE, atol=0.003)


def test_an_error_of_the_absolute_place_shows_in_d_as_the_notes_say():
    moved = geometry([0, 0, 1], 180.0, board_pose(314.0)).d_mm - geometry([0, 0, 1], 180.0).d_mm
    assert moved == pytest.approx(0.216, abs=0.03)


def test_the_uncertainty_of_d_names_its_parts():
    result = geometry([0, 0, 1], 180.0)
    assert set(result.sigma_parts_um) == {"planes", "focal length", "plate's place", "plate's tilt", "stage2"}
    # Turning the board by 0.1 deg about its own centre moves d by 32 um in this rig.
    assert result.sigma_parts_um["plate's tilt"] == pytest.approx(32 * np.rad2deg(5e-5) / 0.1, rel=0.1)
    total = np.sqrt(sum(part**2 for part in result.sigma_parts_um.values()))
    assert 1e3 * result.sigma_d_mm == pytest.approx(total)


def test_a_glass_beyond_the_plates_range_is_said():
    with pytest.raises(CalibrationError, match=r"glass.*extend the plate's positions"):
        geometry([0, 0, 1], 290.0)
