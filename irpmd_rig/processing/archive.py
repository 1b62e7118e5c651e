"""Calibrations and references as files: `calibration.json`, which a person reads, and `arrays.npz` for what is large.

Numbers in JSON keep every digit: what is read is what was computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import (
    BoardPose,
    CameraCalibration,
    Intrinsics,
    Plane,
    PlateRelation,
    ReferenceFrame,
    RigGeometry,
)
from irpmd_rig.core.calibration.plate_order import OrderResidual

ARRAYS = "arrays.npz"
UNITS = "mm, rad, px and their products, unless a name ends in its own unit"

Content = dict[str, Any]


@dataclass(frozen=True, slots=True)
class CameraResult:
    """Camera calibration with the board that lay on the white plate.

    Attributes
    ----------
    camera
        Intrinsics and board poses.
    plate_view
        Index of the image whose board lay on the plate.
    plate_position_mm
        Stage 2 at that image.
    """

    camera: CameraCalibration
    plate_view: int
    plate_position_mm: float

    def content(self) -> Content:
        """Everything as JSON."""
        camera = self.camera
        lens = camera.intrinsics
        return {
            "intrinsics": {
                "size_px": list(lens.size_px),
                "focal_px": list(lens.focal_px),
                "principal_point_px": list(lens.principal_point_px),
                "distortion": list(lens.distortion),
                "distortion_order": "k1, k2, p1, p2, k3 (k3 held at 0)",
                "sigma_focal_px": list(camera.sigma_focal_px),
                "sigma_principal_point_px": list(camera.sigma_principal_point_px),
                "sigma_distortion": list(camera.sigma_distortion),
                "pixel_error_px": list(camera.pixel_error_px),
            },
            "boards": [
                {
                    "view": board.view,
                    "rotation": board.rotation.tolist(),
                    "origin_mm": board.origin_mm.tolist(),
                    "centre_mm": board.centre_mm.tolist(),
                    "sigma_z_mm": board.sigma_z_mm,
                    "sigma_tilt_rad": board.sigma_tilt_rad,
                    "rms_px": board.rms_px,
                }
                for board in camera.boards
            ],
            "missed_views": list(camera.missed_views),
            "plate_view": self.plate_view,
            "plate_position_mm": self.plate_position_mm,
        }

    @staticmethod
    def read(content: Content) -> CameraResult:
        """Make it again; raises KeyError, TypeError or ValueError if something is missing or wrong."""
        lens = content["intrinsics"]
        boards = tuple(
            BoardPose(
                view=board["view"],
                rotation=np.array(board["rotation"], dtype=np.float64),
                origin_mm=np.array(board["origin_mm"], dtype=np.float64),
                centre_mm=np.array(board["centre_mm"], dtype=np.float64),
                sigma_z_mm=board["sigma_z_mm"],
                sigma_tilt_rad=board["sigma_tilt_rad"],
                rms_px=board["rms_px"],
            )
            for board in content["boards"]
        )
        camera = CameraCalibration(
            intrinsics=_intrinsics(lens),
            sigma_focal_px=tuple(lens["sigma_focal_px"]),
            sigma_principal_point_px=tuple(lens["sigma_principal_point_px"]),
            sigma_distortion=tuple(lens["sigma_distortion"]),
            pixel_error_px=tuple(lens["pixel_error_px"]),
            boards=boards,
            missed_views=tuple(content["missed_views"]),
        )
        return CameraResult(camera, int(content["plate_view"]), float(content["plate_position_mm"]))


def _intrinsics(lens: Content) -> Intrinsics:
    return Intrinsics(
        size_px=tuple(lens["size_px"]),
        focal_px=tuple(lens["focal_px"]),
        principal_point_px=tuple(lens["principal_point_px"]),
        distortion=tuple(lens["distortion"]),
    )


def relation_content(relation: PlateRelation) -> Content:
    """What a person wants to know of a plate relation."""
    return {
        "order": relation.order,
        "positions_mm": relation.positions_mm.tolist(),
        "valid_fraction": float(relation.valid.mean()),
        "residuals": [
            {"order": r.order, "pixel_um": r.pixel_um, "coherent_um": r.coherent_um} for r in relation.residuals
        ],
    }


def relation_arrays(relation: PlateRelation) -> dict[str, NDArray[Any]]:
    """Give the arrays of a plate relation by name."""
    return {
        "coefficients_mm": relation.coefficients_mm,
        "centre_rad": relation.centre_rad,
        "half_range_rad": relation.half_range_rad,
    }


def read_relation(content: Content, array: Callable[[str], NDArray[Any]]) -> PlateRelation:
    """Make a plate relation again; raises KeyError, TypeError or ValueError if something is missing or wrong."""
    return PlateRelation(
        **{name: array(name) for name in ("coefficients_mm", "centre_rad", "half_range_rad")},
        positions_mm=np.array(content["positions_mm"], dtype=np.float64),
        order=int(content["order"]),
        residuals=tuple(OrderResidual(r["order"], r["pixel_um"], r["coherent_um"]) for r in content["residuals"]),
    )


def geometry_content(geometry: RigGeometry, stage1_mm: float) -> Content:
    """Everything of a rig's geometry as JSON; ``stage1_mm`` is where it was taken."""
    return {
        "alpha_deg": float(np.rad2deg(geometry.alpha_rad)),
        "beta_deg": float(np.rad2deg(geometry.beta_rad)),
        "gamma_deg": float(np.rad2deg(geometry.gamma_rad)),
        "angles_rad": [geometry.alpha_rad, geometry.beta_rad, geometry.gamma_rad],
        "d_mm": geometry.d_mm,
        "d_is": "along the reference's normal, from the drawing's d_point to the fitted glass plane, at stage1_mm",
        "stage1_mm": stage1_mm,
        "sigma_d_mm": geometry.sigma_d_mm,
        "sigma_parts_um": geometry.sigma_parts_um,
        "d_seen_mean_mm": geometry.d_seen_mean_mm,
        "camera_mm": geometry.frame.camera_mm.tolist(),
        "axes_in_camera": geometry.frame.axes.tolist(),
        "mirror": _plane_content(geometry.mirror),
        "glass": _plane_content(geometry.glass),
    }


def read_geometry(content: Content) -> RigGeometry:
    """Make a geometry again; raises KeyError, TypeError or ValueError if something is missing or wrong."""
    alpha, beta, gamma = content["angles_rad"]
    return RigGeometry(
        mirror=_plane(content["mirror"]),
        glass=_plane(content["glass"]),
        frame=ReferenceFrame(np.array(content["axes_in_camera"]), np.array(content["camera_mm"])),
        alpha_rad=alpha,
        beta_rad=beta,
        gamma_rad=gamma,
        d_mm=float(content["d_mm"]),
        d_seen_mean_mm=float(content["d_seen_mean_mm"]),
        sigma_d_mm=float(content["sigma_d_mm"]),
        sigma_parts_um=dict(content["sigma_parts_um"]),
    )


def _plane_content(plane: Plane) -> Content:
    return {
        "q_per_mm": plane.q.tolist(),
        "covariance_per_mm2": plane.covariance.tolist(),
        "rms_mm": plane.rms_mm,
        "pixels": plane.pixels,
    }


def _plane(content: Content) -> Plane:
    return Plane(
        np.array(content["q_per_mm"]), np.array(content["covariance_per_mm2"]), content["rms_mm"], content["pixels"]
    )
