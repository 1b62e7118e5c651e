"""Where in the picture the glass is seen directly, at any stage position, once the rig is calibrated."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.regions import Mask

Array = NDArray[np.float64]

# Straight edges of the glass are bent by the lens: between points so close by far less than a pixel.
_SPACING_MM = 2.0


def glass_outline(model: RigModel, positions_mm: Sequence[float], masks: Sequence[Mask]) -> Array:
    """Outline of the part of the glass that is seen lit at any of several stage positions.

    Parameters
    ----------
    model
        The calibrated rig.
    positions_mm
        Stage positions.
    masks
        Where the glass is lit at each, (H, W).

    Returns
    -------
    ndarray, (n, 2)
        Corners of its convex hull: x and y of frame M at s = 0, mm; no corners where nothing is lit.
    """
    found = []
    for position_mm, mask in zip(positions_mm, masks, strict=True):
        contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        for contour in contours:
            rays = rays_at(model.intrinsics, contour[:, 0, :])
            camera = model.still(model.frame.camera_mm, position_mm)
            found.append(model.meet_glass(camera, model.frame.directions(rays))[:, :2])
    if not found:
        return np.empty((0, 2))
    points = np.concatenate(found).astype(np.float32)
    return np.asarray(cv2.convexHull(points)[:, 0, :], dtype=np.float64)


def glass_mask(model: RigModel, outline_mm: Array, position_mm: float) -> Mask:
    """Pixels whose rays meet the glass within an outline before anything behind it.

    Parameters
    ----------
    model
        The calibrated rig.
    outline_mm
        As `glass_outline` gives it.
    position_mm
        Stage position.

    Returns
    -------
    ndarray of bool, (H, W)
    """
    width, height = model.intrinsics.size_px
    mask = np.zeros((height, width), np.uint8)
    if len(outline_mm):
        points = _densely(outline_mm)
        still = np.concatenate([points, model.glass_z_mm(*points.T)[:, None]], axis=1)
        seen = (still - model.still(model.frame.camera_mm, position_mm)) @ model.frame.axes
        # What lies behind the camera is not in its picture.
        seen = seen[seen[:, 2] > 0]
        if len(seen) > 2:
            lens = model.intrinsics
            places, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion))
            cv2.fillPoly(mask, [np.rint(places[:, 0]).astype(np.int32)], 1)
    return mask.astype(bool)


def _densely(outline_mm: Array) -> Array:
    ends = np.roll(outline_mm, -1, axis=0)
    parts = []
    for start, end in zip(outline_mm, ends, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(end - start) / _SPACING_MM)))
        parts.append(start + np.linspace(0, 1, count, endpoint=False)[:, None] * (end - start))
    return np.concatenate(parts)
