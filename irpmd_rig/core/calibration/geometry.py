"""Glass and reference mirror: their planes, the angles between them and the distance d (the paper, step 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.intrinsics import CameraCalibration
from irpmd_rig.core.calibration.plate import PlatePlacement, PlateRelation
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.frame import ReferenceFrame, reference_frame
from irpmd_rig.core.planes import Plane, fit_plane

# The systematic parts of d are found by moving one input at a time; a coarse grid of pixels tells as much.
_SENSITIVITY_STRIDE = 8
STAGE2_SIGMA_MM = 1e-3


@dataclass(frozen=True, slots=True)
class Drawing:
    """What the rig's drawing says about frame M; nothing here needs to be exact.

    Attributes
    ----------
    camera_xy_mm : tuple of float
        The camera's place over the reference plane.
    heading : tuple of float
        Direction in x, y in which it looks.
    d_point_mm : tuple of float
        Point (x, y, 0) of M from which d is measured: below the middle of the glass.
    """

    camera_xy_mm: tuple[float, float] = (-160.0, 0.0)
    heading: tuple[float, float] = (1.0, 0.0)
    d_point_mm: tuple[float, float] = (125.0, 0.0)


@dataclass(frozen=True, slots=True)
class RigGeometry:
    """Result of the paper's geometric calibration.

    Attributes
    ----------
    mirror, glass : Plane
        In the camera's frame.
    frame : ReferenceFrame
        Frame M, on the mirror.
    alpha_rad, beta_rad, gamma_rad : float
        Angles of the glass's normal with the x, y and z axes of M: 90, 90 and 0 degrees if it is parallel.
    d_mm : float
        Along the reference's normal from `Drawing.d_point_mm` to the fitted glass plane.
    d_seen_mean_mm : float
        The paper's d: mean distance from the seen glass points to the reference plane.
    sigma_d_mm : float
        One sigma of d_mm: planes, stage2, absolute place and tilt of the plate, focal length.
    sigma_parts_um : dict
        The parts of sigma_d by name, um.
    """

    mirror: Plane
    glass: Plane
    frame: ReferenceFrame
    alpha_rad: float
    beta_rad: float
    gamma_rad: float
    d_mm: float
    d_seen_mean_mm: float
    sigma_d_mm: float
    sigma_parts_um: dict[str, float]


@dataclass(frozen=True, slots=True)
class _Seen:
    """Plate positions that the pixels of one flat target read, with their rays."""

    position_mm: NDArray[np.float64]
    rays: NDArray[np.float64]
    mask: NDArray[np.bool_]

    def plane(self, placement: PlatePlacement) -> Plane:
        return fit_plane(self.rays, placement.depth_mm(self.position_mm, self.rays), self.mask)

    def thinned(self) -> _Seen:
        step = _SENSITIVITY_STRIDE
        return _Seen(self.position_mm[::step, ::step], self.rays[::step, ::step], self.mask[::step, ::step])


def calibrate_geometry(
    camera: CameraCalibration,
    relation: PlateRelation,
    placement: PlatePlacement,
    phase_rad: NDArray[np.floating],
    mirror_mask: NDArray[np.bool_],
    glass_mask: NDArray[np.bool_],
    *,
    rays: NDArray[np.float64],
    drawing: Drawing | None = None,
    board_view: int,
    stage2_sigma_mm: float = STAGE2_SIGMA_MM,
) -> RigGeometry:
    """Planes of sprayed mirror and glass, their angles, and d with its uncertainty.

    Parameters
    ----------
    camera : CameraCalibration
        For the uncertainties of focal length and board pose.
    relation, placement
        Phase to plate position, and the plate's absolute place.
    phase_rad : ndarray, (H, W)
        Absolute phase of the picture that shows the sprayed mirror and the glass directly.
    mirror_mask, glass_mask : ndarray of bool, (H, W)
        Where each of them is seen.
    rays : ndarray, (H, W, 3)
        Undistorted rays of the camera.
    drawing : Drawing, optional
        Nominal places, the rig of the paper by default.
    board_view : int
        Index of the image whose board lies on the plate.
    stage2_sigma_mm : float
        Accuracy of a stage2 position; the paper's stage has 1 um.

    Returns
    -------
    RigGeometry
        See there.

    Raises
    ------
    CalibrationError
        If a target is not seen, or its phases lie outside what the plate covered.
    """
    drawing = drawing or Drawing()
    position = relation.position_mm(phase_rad)
    mirror_seen = _seen(position, rays, mirror_mask, "sprayed mirror")
    glass_seen = _seen(position, rays, glass_mask, "glass")
    mirror, glass = mirror_seen.plane(placement), glass_seen.plane(placement)
    frame = reference_frame(mirror, camera_xy_mm=drawing.camera_xy_mm, heading=drawing.heading)
    normal, _ = frame.plane(glass)
    d_mm = _distance(mirror, glass, drawing)
    depth = placement.depth_mm(glass_seen.position_mm, rays)
    seen_heights = (depth[..., None] * frame.directions(rays))[..., 2][glass_seen.mask] + frame.camera_mm[2]
    parts = {
        "planes": _plane_part_um(mirror, glass, drawing),
        **_systematic_parts_um(camera, placement, mirror_seen, glass_seen, drawing, board_view),
        "stage2": _stage2_part_um(relation, placement, (mirror_seen, glass_seen), drawing, stage2_sigma_mm),
    }
    return RigGeometry(
        mirror=mirror,
        glass=glass,
        frame=frame,
        alpha_rad=float(np.arccos(normal[0])),
        beta_rad=float(np.arccos(normal[1])),
        gamma_rad=float(np.arctan2(np.hypot(normal[0], normal[1]), normal[2])),
        d_mm=d_mm,
        d_seen_mean_mm=float(np.mean(seen_heights)),
        sigma_d_mm=1e-3 * float(np.sqrt(sum(part**2 for part in parts.values()))),
        sigma_parts_um=parts,
    )


def _seen(position_mm: NDArray[np.float64], rays: NDArray[np.float64], mask: NDArray[np.bool_], target: str) -> _Seen:
    usable = mask & np.isfinite(position_mm)
    if usable.sum() < 0.2 * mask.sum() or not usable.any():
        raise CalibrationError(
            f"of {int(mask.sum())} pixels of the {target} only {int(usable.sum())} show a phase that the white "
            f"plate covered: extend the plate's positions to the {target}, or check that it is seen and lit"
        )
    return _Seen(position_mm, rays, usable)


def _distance(mirror: Plane, glass: Plane, drawing: Drawing) -> float:
    """Distance along the mirror's normal from the drawing's point of the reference plane to the glass plane."""
    frame = reference_frame(mirror, camera_xy_mm=drawing.camera_xy_mm, heading=drawing.heading)
    normal, offset = frame.plane(glass)
    x, y = drawing.d_point_mm
    return float((offset - normal[0] * x - normal[1] * y) / normal[2])


def _plane_part_um(mirror: Plane, glass: Plane, drawing: Drawing) -> float:
    """Standard deviation of d from the covariances of the two planes."""
    variance = 0.0
    base = _distance(mirror, glass, drawing)
    for which, plane in enumerate((mirror, glass)):
        step = 1e-6 * np.linalg.norm(plane.q)
        gradient = np.empty(3)
        for axis in range(3):
            moved = replace(plane, q=plane.q + step * np.eye(3)[axis])
            planes = (moved, glass) if which == 0 else (mirror, moved)
            gradient[axis] = (_distance(*planes, drawing) - base) / step
        variance += float(gradient @ plane.covariance @ gradient)
    return 1e3 * float(np.sqrt(variance))


def _systematic_parts_um(
    camera: CameraCalibration,
    placement: PlatePlacement,
    mirror: _Seen,
    glass: _Seen,
    drawing: Drawing,
    board_view: int,
) -> dict[str, float]:
    """Change of d when one uncertain input moves by one sigma, um."""
    mirror, glass = mirror.thinned(), glass.thinned()

    def distance(placement: PlatePlacement, stretch: float = 1.0) -> float:
        scale = np.array([stretch, stretch, 1.0])
        planes = [replace(s, rays=s.rays * scale).plane(placement) for s in (mirror, glass)]
        return _distance(planes[0], planes[1], drawing)

    base = distance(placement)
    return {
        name: 1e3 * float(np.sqrt(sum((distance(*case) - base) ** 2 for case in cases)))
        for name, cases in _one_sigma_cases(camera, placement, board_view)
    }


def _stage2_part_um(
    relation: PlateRelation,
    placement: PlatePlacement,
    seen: tuple[_Seen, _Seen],
    drawing: Drawing,
    sigma_mm: float,
) -> float:
    """Standard deviation of d when every plate position, and the board's, is off by its own sigma.

    The polynomial follows a wrong position as far as its order lets it; the sprayed strip is narrow, so that what is
    left of it turns the mirror's plane.
    """
    thin = [target.thinned() for target in seen]
    middle, half = relation.positions_mm.mean(), 0.5 * np.ptp(relation.positions_mm)

    def powers(position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        normalised: NDArray[np.float64] = ((position_mm - middle) / half)[..., None]
        return np.asarray(normalised ** np.arange(relation.order + 1))

    response = sigma_mm * np.linalg.pinv(powers(relation.positions_mm))

    def distance(targets: list[_Seen], placement: PlatePlacement) -> float:
        mirror, glass = (target.plane(placement) for target in targets)
        return _distance(mirror, glass, drawing)

    base = distance(thin, placement)
    variance = 0.0
    for position in range(len(relation.positions_mm)):
        moved = [replace(t, position_mm=t.position_mm + powers(t.position_mm) @ response[:, position]) for t in thin]
        variance += (distance(moved, placement) - base) ** 2
    board = replace(placement, position_mm=placement.position_mm + sigma_mm)
    variance += (distance(thin, board) - base) ** 2
    return 1e3 * float(np.sqrt(variance))


def _one_sigma_cases(
    camera: CameraCalibration, placement: PlatePlacement, board_view: int
) -> Iterator[tuple[str, list[tuple[PlatePlacement, float]]]]:
    board = next(board for board in camera.boards if board.view == board_view)
    focal = camera.sigma_focal_px[0] / camera.intrinsics.focal_px[0]
    distance_mm = float(board.centre_mm[2])
    # A longer focal length puts the board farther away, so these two move together; what is left of the board's
    # own uncertainty moves alone.
    alone = np.sqrt(max(board.sigma_z_mm**2 - (focal * distance_mm) ** 2, 0.0))
    farther = placement.point_mm * np.array([1.0, 1.0, 1.0 + focal])
    yield "focal length", [(replace(placement, point_mm=farther), 1.0 / (1.0 + focal))]
    moved = placement.point_mm + np.array([0.0, 0.0, alone])
    yield "plate's place", [(replace(placement, point_mm=moved), 1.0)]
    tilted = []
    for axis in range(2):
        turn = np.cross(np.eye(3)[axis], placement.normal) * board.sigma_tilt_rad
        normal = placement.normal + turn
        tilted.append((replace(placement, normal=normal / np.linalg.norm(normal)), 1.0))
    yield "plate's tilt", tilted
