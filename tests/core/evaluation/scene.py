"""Stepped mirrors seen by the oblique camera of the physics notes, section 2, as depth maps with noise."""

import numpy as np

from irpmd_rig.core import Intrinsics, ReferenceFrame, rays

ANGLE = np.deg2rad(37)
FRAME = ReferenceFrame(
    np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, -1, 0], [np.sin(ANGLE), 0, -np.cos(ANGLE)]]).T,
    np.array([-160.0, 0.0, 330.0]),
)
# The middle of the paper's camera, with the object in view, at half its resolution.
CAMERA = Intrinsics((400, 320), (1177.5, 1177.8), (330.0, 160.0))
RAYS = rays(CAMERA)
DIRECTIONS = FRAME.directions(RAYS)
TABLE_2 = (3.9868, 7.0248, 5.0062, 6.0986)


def heights_of(steps_mm):
    levels = np.concatenate([[0.0], np.cumsum(steps_mm)])
    return levels - levels.mean()


def stepped_depth(steps_mm=TABLE_2, along="y", slopes=(0.0, 0.0), noise_mm=0.0, seed=0, zone=((0, 72), (-36, 36))):
    """Depth map (H, W) and true facet (H, W; -1 outside); noise is along the ray, as that of the depth equation."""
    heights = heights_of(steps_mm)
    depth = np.full(RAYS.shape[:2], np.nan)
    facet = np.full(RAYS.shape[:2], -1)
    low, high = zone[0] if along == "x" else zone[1]
    edges = np.linspace(low, high, len(heights) + 1)
    # From the lowest up: a higher tread hides what lies behind it.
    for index, height in enumerate(heights):
        x, y, z = on_plane(height, slopes)
        place = x if along == "x" else y
        inside = (x >= zone[0][0]) & (x < zone[0][1]) & (y >= zone[1][0]) & (y < zone[1][1])
        inside &= (place >= edges[index]) & (place < edges[index + 1])
        depth[inside], facet[inside] = z[inside], index
    depth += np.random.default_rng(seed).normal(0, noise_mm, depth.shape) if noise_mm else 0.0
    return depth, facet


def on_plane(height, slopes):
    """Where every ray meets z = height + slopes . (xy - (36, 0))."""
    normal = np.array([-slopes[0], -slopes[1], 1.0])
    offset = height - slopes[0] * 36
    reach = (offset - FRAME.camera_mm @ normal) / (DIRECTIONS @ normal)
    points = FRAME.camera_mm + reach[..., None] * DIRECTIONS
    return points[..., 0], points[..., 1], points[..., 2]
