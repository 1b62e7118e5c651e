"""What the demonstration leaves on disk."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from irpmd_rig.demo.procedure import Calibration, Measurement


def write_calibration(calibration: Calibration, folder: Path) -> None:
    """Write ``calibration.json`` (what a person reads) and ``references.npz`` (the reference phases)."""
    camera, geometry = calibration.camera, calibration.geometry
    content = {
        "intrinsics": {
            **asdict(camera.intrinsics),
            "sigma_focal_px": camera.sigma_focal_px,
            "sigma_principal_point_px": camera.sigma_principal_point_px,
            "sigma_distortion": camera.sigma_distortion,
            "pixel_error_px": camera.pixel_error_px,
        },
        "plate_relation": {
            "order": calibration.relation.order,
            "residuals": [asdict(residual) for residual in calibration.relation.residuals],
        },
        "geometry": {
            "alpha_deg": float(np.rad2deg(geometry.alpha_rad)),
            "beta_deg": float(np.rad2deg(geometry.beta_rad)),
            "gamma_deg": float(np.rad2deg(geometry.gamma_rad)),
            "d_mm": geometry.d_mm,
            "sigma_d_mm": geometry.sigma_d_mm,
            "sigma_parts_um": geometry.sigma_parts_um,
            "d_seen_mean_mm": geometry.d_seen_mean_mm,
            "camera_mm": geometry.frame.camera_mm.tolist(),
            "axes_in_camera": geometry.frame.axes.tolist(),
        },
    }
    write_json(content, folder / "calibration.json")
    references = {
        f"position_{k + 1}_rad": reference.phase_rad.astype(np.float32)
        for k, reference in enumerate(calibration.references)
    }
    np.savez(folder / "references.npz", allow_pickle=False, **references)


def write_measurement(measurement: Measurement, folder: Path) -> None:
    """Write the depth map (TIFF and npy, mm, NaN where unknown) and the point cloud (PLY, mm)."""
    depth = measurement.depth_mm.astype(np.float32)
    np.save(folder / "depth_mm.npy", depth)
    tifffile.imwrite(folder / "depth_mm.tif", depth, metadata={"unit": "mm"})
    write_points(measurement.points_mm, folder / "points.ply")


def write_points(points_mm: NDArray[np.float64], path: Path) -> None:
    """Write the known points of (H, W, 3) as a binary PLY file."""
    known = points_mm[np.isfinite(points_mm).all(axis=-1)]
    vertices = np.empty(len(known), dtype=[(axis, np.float32) for axis in "xyz"])
    for column, axis in enumerate("xyz"):
        vertices[axis] = known[:, column]
    PlyData([PlyElement.describe(vertices, "vertex")], text=False).write(str(path))


def write_json(content: dict[str, Any], path: Path) -> None:
    """Write a JSON file that a person can read."""
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
