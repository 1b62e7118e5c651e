"""Accuracy of the core alone: the depth equation where it is exact, and the absolute phase of noisy fringes."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import decode, direct_depth

Array = NDArray[np.float64]

COUNTS = (64, 63, 56)
_D_MM = 180.0
_PITCH_MM = 5.77
_CAMERA_MM = np.array([-160.0, 0.0, 330.0])
_TILTS_DEG = (-2.0, -0.6, 0.0, 0.6, 2.0)
_MEAN_DN, _MODULATION_DN, _NOISE_DN = 127.0, 100.0, 1.5


def depth_law_error_mm() -> float:
    """Largest error of the depth equation on exact phases.

    Tilted plane facets and the reference mirror, traced ray by ray, in a rig without misalignment; the stage moves
    away and toward, the phase grows along +x and -x.
    """
    x, y = np.meshgrid(np.linspace(0, 72, 25), np.linspace(-36, 36, 25))
    worst = 0.0
    tilts = product(_TILTS_DEG, _TILTS_DEG)
    for (about_x, about_y), height, travel, sense in product(tilts, (-11.0, 0.0, 11.0), (40.0, -40.0), (1.0, -1.0)):
        slope = np.tan(np.deg2rad([about_y, about_x]))
        points = np.stack([x, y, height + slope[0] * (x - 36) + slope[1] * y], axis=-1)
        rays = points - _CAMERA_MM
        # Where the same camera rays meet the reference plane.
        flat = _CAMERA_MM - rays * (_CAMERA_MM[2] / rays[..., 2:])
        phases = [
            _phase_rad(surface, _reflected(rays, normal), _D_MM + s, sense)
            for surface, normal in ((flat, (0.0, 0.0)), (points, slope))
            for s in (0.0, travel)
        ]
        found = direct_depth(*phases, d_mm=_D_MM, delta_d_mm=travel)
        worst = max(worst, float(np.abs(found - points[..., 2]).max()))
    return worst


def _reflected(rays: Array, slope: tuple[float, float] | Array) -> Array:
    normal = np.array([-slope[0], -slope[1], 1.0])
    normal /= np.linalg.norm(normal)
    return np.asarray(rays - 2 * (rays @ normal)[..., None] * normal)


def _phase_rad(points: Array, directions: Array, glass_mm: float, sense: float) -> Array:
    """Phase at the glass's x where rays from points meet the glass."""
    along = (glass_mm - points[..., 2]) / directions[..., 2]
    return np.asarray(200.0 + sense * 2 * np.pi / _PITCH_MM * (points[..., 0] + along * directions[..., 0]))


def absolute_phase(seed: int, size_px: int) -> tuple[float, int]:
    """Decode noisy fringes over all projector columns, 0 to 1024.

    Returns
    -------
    rms_rad
        Of the absolute phase.
    wrong
        Pixels of a wrong fringe order, or of none, but for the outermost wrap: a phase at one end of the projector
        may come out at the other.
    """
    rng = np.random.default_rng(seed)
    position = np.broadcast_to((np.arange(size_px) + 0.5) / size_px, (size_px, size_px))
    frames = np.empty((len(COUNTS), 4, size_px, size_px), np.uint8)
    for k, n in product(range(len(COUNTS)), range(4)):
        ideal = _MEAN_DN + _MODULATION_DN * np.cos(2 * np.pi * (COUNTS[k] * position + n / 4))
        frames[k, n] = np.rint(ideal + rng.normal(0, _NOISE_DN, ideal.shape))
    whole = 2 * np.pi * COUNTS[0]
    error = decode(frames, COUNTS).phase_rad - whole * position
    error -= whole * np.rint(error / whole)
    right = np.abs(error) < np.pi
    return float(np.sqrt(np.mean(error[right] ** 2))), int(np.count_nonzero(~right))
