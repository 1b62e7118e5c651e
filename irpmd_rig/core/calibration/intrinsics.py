"""Camera intrinsics from images of a checkerboard (the paper, section 2.2, step 1, and Table 1)."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.arguments import whole_number
from irpmd_rig.core.camera import Intrinsics
from irpmd_rig.core.errors import CalibrationError, FramesError

FEWEST_BOARDS = 3
_SMALLEST_IMAGE_PX = 64
_NEIGHBOURS = (2, 3, 4)  # sides of groups of corners whose errors may hang together
# k3 is held at zero, as in Table 1: 30 boards of this lens do not determine it.
_FLAGS = cv2.CALIB_FIX_K3
_REFINEMENT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-4)


@dataclass(frozen=True, slots=True)
class Checkerboard:
    """A checkerboard: inner corners (rows, columns) and the side of a square in mm."""

    inner_corners: tuple[int, int] = (13, 11)
    square_mm: float = 10.0

    def __post_init__(self) -> None:
        whole = len(self.inner_corners) == 2 and all(isinstance(n, int) and n >= 3 for n in self.inner_corners)
        if not whole or not 0 < self.square_mm < np.inf:
            raise CalibrationError(
                f"a checkerboard needs at least 3 x 3 inner corners and a positive square, "
                f"not {self.inner_corners} and {self.square_mm} mm"
            )

    @property
    def points_mm(self) -> NDArray[np.float32]:
        """Inner corners in the board's own plane, (rows * columns, 3), mm."""
        rows, columns = self.inner_corners
        row, column = np.mgrid[:rows, :columns]
        points = np.stack([row, column, np.zeros_like(row)], axis=-1).reshape(-1, 3)
        return (points * self.square_mm).astype(np.float32)


@dataclass(frozen=True, slots=True)
class BoardPose:
    """Pose of a board in the camera frame, with one-sigma uncertainties from the bundle adjustment.

    Attributes
    ----------
    view : int
        Index of the image in the sequence given.
    rotation : ndarray, (3, 3)
        Board axes as columns.
    origin_mm : ndarray, (3,)
        First inner corner.
    centre_mm : ndarray, (3,)
        Middle of the inner corners.
    sigma_z_mm : float
        Standard deviation of the distance along the optical axis, intrinsics included.
    sigma_tilt_rad : float
        Standard deviation of the board's tilt about an axis across the line of sight.
    rms_px : float
        Reprojection error of this view.
    """

    view: int
    rotation: NDArray[np.float64]
    origin_mm: NDArray[np.float64]
    centre_mm: NDArray[np.float64]
    sigma_z_mm: float
    sigma_tilt_rad: float
    rms_px: float


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Intrinsics with one-sigma uncertainties, in the form of the paper's Table 1.

    Attributes
    ----------
    intrinsics : Intrinsics
        The estimate.
    sigma_focal_px, sigma_principal_point_px : tuple of float
        Standard deviations, px.
    sigma_distortion : tuple of float
        Standard deviations of k1, k2, p1, p2, k3 (k3 is fixed at 0).
    pixel_error_px : tuple of float
        Standard deviation of the reprojection error along columns and rows, px.
    boards : tuple of BoardPose
        Poses of the boards that were found, in the order of the images.
    missed_views : tuple of int
        Images in which the board was not found.
    """

    intrinsics: Intrinsics
    sigma_focal_px: tuple[float, float]
    sigma_principal_point_px: tuple[float, float]
    sigma_distortion: tuple[float, float, float, float, float]
    pixel_error_px: tuple[float, float]
    boards: tuple[BoardPose, ...]
    missed_views: tuple[int, ...]


def find_corners(image: NDArray[np.uint8] | NDArray[np.uint16], board: Checkerboard) -> NDArray[np.float32] | None:
    """Inner corners of a checkerboard to a fraction of a pixel.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, (H, W)
        A frame; 16-bit frames are stretched to their own brightest value first.
    board : Checkerboard
        The board to look for; all inner corners must be visible.

    Returns
    -------
    ndarray of float32, (rows * columns, 1, 2), or None
        Corners (column, row) in px in the order of `Checkerboard.points_mm`; None where the board is not found.

    Raises
    ------
    FramesError
        For an image that is not a single grey frame.
    """
    picture: NDArray[Any] = np.asarray(image)
    if picture.ndim != 2 or picture.dtype not in (np.uint8, np.uint16) or min(picture.shape) < _SMALLEST_IMAGE_PX:
        raise FramesError(
            f"a board image must be (H, W) uint8 or uint16 of at least {_SMALLEST_IMAGE_PX} px a side, "
            f"not {picture.shape} {picture.dtype}"
        )
    grey = picture
    if picture.dtype == np.uint16:
        grey = (picture * (255.0 / max(int(picture.max()), 1))).astype(np.uint8)
    rows, columns = board.inner_corners
    # Detection needs no fine pixels, the refinement does: a board fills hundreds of them.
    scale = max(1, min(picture.shape) // 700)
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    found, corners = cv2.findChessboardCorners(
        small, (columns, rows), flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        return None
    corners = (corners + 0.5) * scale - 0.5
    window = _refinement_window(corners, rows, columns)
    refined = cv2.cornerSubPix(grey, corners.astype(np.float32), (window, window), (-1, -1), _REFINEMENT)
    return np.asarray(refined, dtype=np.float32)


def _refinement_window(corners: NDArray[np.float32], rows: int, columns: int) -> int:
    """Half-width of the search window: as large as fits without touching the neighbouring corners."""
    grid = corners.reshape(rows, columns, 2)
    spacing = min(
        np.linalg.norm(np.diff(grid, axis=0), axis=-1).min(),
        np.linalg.norm(np.diff(grid, axis=1), axis=-1).min(),
    )
    return int(np.clip(spacing * 0.35, 3, 15))


def calibrate_camera(
    images: Sequence[NDArray[np.uint8] | NDArray[np.uint16]],
    board: Checkerboard | None = None,
    *,
    threads: int = 1,
) -> CameraCalibration:
    """Intrinsics, distortion and their uncertainties from images of a checkerboard.

    Parameters
    ----------
    images : sequence of ndarray, (H, W)
        Frames of the board in different poses, all of one size.
    board : Checkerboard, optional
        The paper's board (13 x 11 inner corners, 10 mm) by default.
    threads : int
        Images searched at the same time.

    Returns
    -------
    CameraCalibration
        With the pose of each board that was found.

    Raises
    ------
    FramesError
        If the images differ in size or are no grey frames.
    CalibrationError
        If the board is found in fewer than three images, or all its poses are parallel (then focal length and
        distance cannot be told apart).

    Notes
    -----
    Bouguet's model (the paper, reference 29) as implemented by OpenCV; k3 is held at zero as in Table 1.
    """
    board = board or Checkerboard()
    whole_number("threads", threads, least=1)
    try:
        frames: list[NDArray[Any]] = [np.asarray(image) for image in images]
    except (TypeError, ValueError) as error:
        raise FramesError(f"board images must be a sequence of (H, W) frames: {error}") from None
    if len({frame.shape for frame in frames}) > 1:
        raise FramesError(f"board images differ in size: {sorted({frame.shape for frame in frames})}")
    with ThreadPoolExecutor(threads) as pool:
        corners = list(pool.map(lambda frame: find_corners(frame, board), frames))
    views = [(view, c) for view, c in enumerate(corners) if c is not None]
    if len(views) < FEWEST_BOARDS:
        raise CalibrationError(
            f"the board of {board.inner_corners} inner corners was found in {len(views)} of {len(frames)} images; "
            f"at least {FEWEST_BOARDS} are needed: check focus, exposure and that all corners are in the picture"
        )
    height, width = frames[0].shape
    return _bundle_adjust(views, board, (width, height), len(frames))


def _bundle_adjust(
    views: list[tuple[int, NDArray[np.float32]]],
    board: Checkerboard,
    size_px: tuple[int, int],
    image_count: int,
) -> CameraCalibration:
    points = board.points_mm
    observed = [corners for _, corners in views]
    _, matrix, distortion, rotations, translations, sigma, sigma_poses, rms = cv2.calibrateCameraExtended(
        [points] * len(views), observed, size_px, None, None, flags=_FLAGS
    )
    normals = np.array([cv2.Rodrigues(r)[0][:, 2] for r in rotations])
    spread_rad = np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1)).max()
    if spread_rad < np.deg2rad(3):
        raise CalibrationError(
            f"all boards are parallel within {np.rad2deg(spread_rad):.1f} deg: focal length and distance cannot be "
            "told apart; add boards tilted by 10 to 40 deg about both axes"
        )
    intrinsics = Intrinsics(
        size_px=size_px,
        focal_px=(float(matrix[0, 0]), float(matrix[1, 1])),
        principal_point_px=(float(matrix[0, 2]), float(matrix[1, 2])),
        distortion=tuple(float(k) for k in np.ravel(distortion)[:5]),  # type: ignore[arg-type]
    )
    sigma = np.ravel(sigma)
    sigma_poses = np.ravel(sigma_poses).reshape(len(views), 6)
    residuals = []
    boards = []
    grid = (*board.inner_corners, 2)
    for index, (view, corners) in enumerate(views):
        projected, _ = cv2.projectPoints(points, rotations[index], translations[index], matrix, np.asarray(distortion))
        residuals.append(np.reshape(corners, (-1, 2)) - np.reshape(projected, (-1, 2)))
        excess = float(np.sqrt(neighbours_excess(residuals[-1].reshape(grid))))
        rotation = cv2.Rodrigues(rotations[index])[0]
        origin = np.ravel(translations[index])
        boards.append(
            BoardPose(
                view=view,
                rotation=rotation,
                origin_mm=origin,
                centre_mm=rotation @ points.mean(axis=0).astype(np.float64) + origin,
                sigma_z_mm=excess * float(sigma_poses[index, 5]),
                sigma_tilt_rad=excess * float(np.sqrt(np.mean(sigma_poses[index, :2] ** 2))),
                rms_px=float(np.ravel(rms)[index]),
            )
        )
    errors = np.concatenate(residuals).std(axis=0)
    found = {view for view, _ in views}
    return CameraCalibration(
        intrinsics=intrinsics,
        sigma_focal_px=(float(sigma[0]), float(sigma[1])),
        sigma_principal_point_px=(float(sigma[2]), float(sigma[3])),
        sigma_distortion=tuple(float(s) for s in sigma[4:9]),  # type: ignore[arg-type]
        pixel_error_px=(float(errors[0]), float(errors[1])),
        boards=tuple(boards),
        missed_views=tuple(view for view in range(image_count) if view not in found),
    )


def neighbours_excess(residual_px: NDArray[np.floating]) -> float:
    """Factor (at least 1) by which variances of sums over neighbouring corners exceed those of independent ones.

    Parameters
    ----------
    residual_px : ndarray, (rows, columns, 2)
        Of the corners of one board.

    Notes
    -----
    On a board that stands nearly along the camera's pixels, neighbouring corners lie alike on their pixels, and their
    places err alike: by up to 0.8 of the whole at 14 px a square, 0.4 at 75 px. A pose is made of sums over many of
    them. The largest excess that chance does not explain counts.
    """
    variance, excess = float(np.mean(residual_px**2)), 1.0
    for side in _NEIGHBOURS:
        rows, columns = (size // side for size in residual_px.shape[:2])
        sums = residual_px[: rows * side, : columns * side].reshape(rows, side, columns, side, 2).sum(axis=(1, 3))
        here = float(np.mean(sums**2)) / (side**2 * variance) if sums.size and variance else 1.0
        if here > 1 + 2.5 * np.sqrt(2 / max(sums.size, 1)):
            excess = max(excess, here)
    return excess
