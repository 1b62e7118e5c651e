"""What the checkerboard says about the camera's intrinsics, correlations included."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.intrinsics import CameraCalibration, Checkerboard

INTRINSICS = 8
"""fx, fy, cx, cy, k1, k2, p1, p2."""


def intrinsics_covariance(camera: CameraCalibration, board: Checkerboard) -> NDArray[np.float64]:
    """Covariance (8, 8) of fx, fy, cx, cy, k1, k2, p1, p2 from the boards' reprojections.

    Parameters
    ----------
    camera : CameraCalibration
        With the poses of the boards.
    board : Checkerboard
        Their corners.

    Notes
    -----
    Normal equations of the bundle adjustment, the poses eliminated (Schur complement), times the variance of the
    reprojection errors. Standard deviations alone would not do: focal lengths, principal point and distortion hang
    together.
    """
    lens = camera.intrinsics
    information = np.zeros((INTRINSICS, INTRINSICS))
    for pose in camera.boards:
        _, jacobian = cv2.projectPoints(
            board.points_mm.astype(np.float64),
            cv2.Rodrigues(pose.rotation)[0],
            pose.origin_mm,
            lens.matrix,
            np.array(lens.distortion),
        )
        by_pose, by_lens = jacobian[:, :6], jacobian[:, 6 : 6 + INTRINSICS]
        mixed = by_pose.T @ by_lens
        information += by_lens.T @ by_lens - mixed.T @ np.linalg.solve(by_pose.T @ by_pose, mixed)
    return np.asarray(np.mean(np.square(camera.pixel_error_px)) * np.linalg.inv(information))
