"""Rays of the camera: the inverse of the projection, to double precision."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from irpmd_rig.core import Intrinsics, rays
from irpmd_rig.core.errors import CalibrationError

TABLE_1 = Intrinsics(
    size_px=(2048, 2048),
    focal_px=(2355.03482, 2355.59838),
    principal_point_px=(1016.92767, 1018.56904),
    distortion=(-0.13744, 0.14780, -0.00004, -0.00016, 0.0),
)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3))
def test_projecting_a_ray_gives_its_pixel_back(k1, k2, p1, p2):
    camera = Intrinsics((64, 48), (74.0, 73.0), (30.5, 25.0), (k1, k2, p1, p2, 0.0))
    directions = rays(camera)
    projected, _ = cv2.projectPoints(
        directions.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    columns, rows = np.meshgrid(np.arange(64), np.arange(48))
    np.testing.assert_allclose(projected.reshape(48, 64, 2), np.stack([columns, rows], -1), atol=1e-9)
    assert (directions[..., 2] == 1).all()


def test_the_lens_of_table_1_sees_47_degrees():
    corner = Intrinsics((2048, 2048), *(TABLE_1.focal_px, TABLE_1.principal_point_px, TABLE_1.distortion))
    middle_row = rays(corner)[1018, :, 0]
    assert np.rad2deg(np.arctan(middle_row[-1]) - np.arctan(middle_row[0])) == pytest.approx(47.6, abs=0.3)


@pytest.mark.parametrize("focal", [(0.0, 1.0), (np.nan, 1.0), (1.0, -3.0)])
def test_impossible_intrinsics_are_refused(focal):
    with pytest.raises(CalibrationError, match="positive focal lengths"):
        Intrinsics((64, 48), focal, (30.0, 20.0))
