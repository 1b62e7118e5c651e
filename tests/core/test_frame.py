"""Frame M: heights become points, and the planes come out where they are."""

import numpy as np
import pytest

from irpmd_rig.core import reference_frame
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.planes import Plane

ANGLE = np.deg2rad(37)
# The camera's axes in M (rows), as in the physics notes, section 2.
CAMERA_AXES = np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, -1, 0], [np.sin(ANGLE), 0, -np.cos(ANGLE)]])
CAMERA_MM = np.array([-160.0, 0.0, 330.0])


def plane_in_camera(normal_m, offset_mm):
    """The plane normal . X = offset of M, seen from the camera."""
    normal = CAMERA_AXES @ (np.asarray(normal_m) / np.linalg.norm(normal_m))
    distance = (CAMERA_MM @ normal_m - offset_mm) / np.linalg.norm(normal_m)
    return Plane(-normal / distance, np.zeros((3, 3)), 0.0, 100)


def test_the_camera_stands_where_the_drawing_says():
    frame = reference_frame(plane_in_camera([0, 0, 1], 0.0), camera_xy_mm=(-160.0, 0.0))
    np.testing.assert_allclose(frame.camera_mm, CAMERA_MM, atol=1e-9)
    np.testing.assert_allclose(frame.axes, CAMERA_AXES.T, atol=1e-12)


@pytest.mark.parametrize("heading", [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.6, -0.8)])
def test_the_heading_turns_x_and_y_only(heading):
    frame = reference_frame(plane_in_camera([0, 0, 1], 0.0), heading=heading)
    look = frame.axes @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(look[:2] / np.hypot(*look[:2]), heading, atol=1e-12)
    np.testing.assert_allclose(np.cross(frame.axes[0], frame.axes[1]), frame.axes[2], atol=1e-12)


def test_heights_become_points_on_their_rays():
    frame = reference_frame(plane_in_camera([0, 0, 1], 0.0), camera_xy_mm=(-160.0, 0.0))
    points = np.array([[10.0, -20.0, 5.0], [70.0, 30.0, -11.0]])
    seen = (points - CAMERA_MM) @ CAMERA_AXES.T
    rays = (seen / seen[:, 2:])[None]
    np.testing.assert_allclose(frame.points_mm(points[None, :, 2], rays)[0], points, atol=1e-9)
    assert np.isnan(frame.points_mm(np.full((1, 2), np.nan), rays)).all()


def test_a_tilted_glass_has_its_normal_and_offset_in_m():
    normal = np.array([0.01, -0.02, 1.0]) / np.linalg.norm([0.01, -0.02, 1.0])
    frame = reference_frame(plane_in_camera([0, 0, 1], 0.0), camera_xy_mm=(-160.0, 0.0))
    got_normal, offset = frame.plane(plane_in_camera(normal, 180.0))
    np.testing.assert_allclose(got_normal, normal, atol=1e-12)
    assert offset == pytest.approx(180.0)


def test_a_camera_that_looks_straight_down_has_no_heading():
    with pytest.raises(CalibrationError, match="heading"):
        reference_frame(Plane(np.array([0, 0, 1 / 300]), np.zeros((3, 3)), 0.0, 100))
