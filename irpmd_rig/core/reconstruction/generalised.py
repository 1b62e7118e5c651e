"""The depth equation for a rig that is not ideal: with places on the glass instead of phases, and no intrinsics."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.reconstruction.glass_map import GlassMap
from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.surface_slope import slope_across
from irpmd_rig.core.reconstruction.triangulation import RigTables, rig_tables
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]

# Rounds of the place along the fringes, and those after which the surface's slope along them is taken from its depth.
_ROUNDS = 6
_SLOPE_ROUNDS = (1, 3)
_LEAST_ANGLE = 1e-3


def generalised_depth(
    views: Views, references: Views, model: RigModel, *, tables: RigTables | None = None, slope_rounds: int = 2
) -> DepthMap:
    """Depth from where on the glass the object and a plane reference mirror show their phases.

    Parameters
    ----------
    views : Views
        Phases of the object at two or more positions.
    references : Views
        Phases of the reference mirror (z = 0) in the same window, at two or more positions of its own.
    model : RigModel
        The calibrated rig. Of the camera only its rough directions enter, for the coordinate along the fringes.
    tables : RigTables, optional
        Of the same model, to save their computation.
    slope_rounds : int
        How often, at most twice, the slope along the fringes is taken from the depth; 0: the surface is level.

    Returns
    -------
    DepthMap
        NaN as for `irpmd_rig.core.reconstruction.triangulation.triangulate`, where the reference is unknown, and where
        the light would come from beyond the projector's picture. No slopes.

    Raises
    ------
    FramesError
        If the windows differ.
    CalibrationError
        As `rig_tables`.

    Notes
    -----
    Physics notes, section 5. With x = xR + t z and x = xM + T z, the lines through the lit points of the glass of
    reference and object (x along the fringes' normal): h = (xR - xM) / (T + t), since the viewing ray is the
    reference's line mirrored in z = 0. Errors of the intrinsics cancel. The slope along the fringes comes from the
    depth, as in `triangulate`.
    """
    if views.window != references.window:
        raise FramesError(f"object and reference must have one window, not {views.window} and {references.window}")
    tables = rig_tables(model, np.float64) if tables is None else tables
    rays_x, rays_y = (rays[views.window].astype(np.float64) for rays in (tables.rays_x, tables.rays_y))
    regions = smooth_regions(views)
    with np.errstate(invalid="ignore", divide="ignore"):
        level = np.zeros(views.shape)
        reference = _line(references, tables, _Ray(level, rays_x, rays_y, -rays_y))
        depth, leave_y = level, -rays_y
        slope: NDArray[Any] = level
        for number in range(_ROUNDS):
            measured = _line(views, tables, _Ray(depth, rays_x, rays_y, leave_y))
            turn = measured.rate + reference.rate
            depth = (reference.offset - measured.offset) / turn
            leave_x = measured.rate + tables.along_x.shear * leave_y
            if number in _SLOPE_ROUNDS[:slope_rounds]:
                slope = slope_across(depth, *tables.points_mm(depth, views.window), regions)
            leave_y = _reflected_across(leave_x, rays_x, rays_y, slope)
        variance = measured.variance(depth) + reference.variance(-depth)
        sigma = tables.along_x.mm_per_rad * np.sqrt(variance) / np.abs(turn)
        known = (np.abs(turn) > _LEAST_ANGLE) & (depth < measured.lowest) & (depth < model.frame.camera_mm[2])
        known &= measured.lit & reference.lit
    known &= np.isfinite(depth) & np.isfinite(sigma)
    depth_mm, sigma_mm = (np.where(known, values, np.nan).astype(np.float32) for values in (depth, sigma))
    return DepthMap(depth_mm, sigma_mm)


def _reflected_across(leave_x: Array, rays_x: Array, rays_y: Array, slope: Array) -> Array:
    """dy/dz of the ray that leaves a surface of slope dz/dy, by the law of reflection, from its dx/dz."""
    # With g, the ratio of the lengths of (leave, 1) and (rays, 1): leave_y = -rays_y g - slope (1 + g).
    t = rays_y + slope
    a = 1 + rays_x**2 + rays_y**2 - t**2
    g = (slope * t + np.sqrt((slope * t) ** 2 + a * (1 + leave_x**2 + slope**2))) / a
    return np.asarray(-rays_y * g - slope * (1 + g))


class _Ray(NamedTuple):
    """Estimate of the rays: where on the viewing ray the surface lies, and which way the light leaves it along y."""

    depth: Array
    rays_x: Array
    rays_y: Array
    leave_y: Array


class _Line(NamedTuple):
    """x' = offset + rate z through the lit points, with the sums that give its variance for phases in rad.

    `lit` says whether all of them lie in the projector's picture.
    """

    offset: Array
    rate: Array
    weight: Array
    middle: Array
    spread: Array
    lowest: Array
    lit: NDArray[np.bool_]

    def variance(self, z: Array) -> Array:
        return 1 / self.weight + (z - self.middle) ** 2 / self.spread


def _line(views: Views, tables: RigTables, ray: _Ray) -> _Line:
    model, glass = tables.model, tables.along_x
    weights, places, heights = [], [], []
    lit = np.ones(views.shape, np.bool_)
    for position_mm, phase, sigma in zip(views.positions_mm, views.phases_rad, views.sigmas_rad, strict=True):
        shift = position_mm * model.stage_axis
        camera = model.frame.camera_mm
        z = model.glass[2] - shift[2]
        y = camera[1] + (ray.depth - camera[2]) * ray.rays_y + ray.leave_y * (z - ray.depth) + shift[1]
        known = np.isfinite(phase) & np.isfinite(sigma)
        # A smoothed reference may be given without noise.
        weights.append(np.where(known, 1 / np.maximum(sigma, 1e-6) ** 2, 0.0))
        # Beyond the projector's picture the map is none; noise may point there while the rounds go on.
        y = glass.within(y)
        x = _place(model, glass, np.where(known, phase, glass.along_rad[0]), y)
        height = model.glass_z_mm(x, y) - shift[2]
        # Once more with the height found: the glass is tilted.
        sought = y + ray.leave_y * (height - z)
        y = glass.within(sought)
        lit &= (y == sought) | ~known
        x = _place(model, glass, np.where(known, phase, glass.along_rad[0]), y)
        heights.append(model.glass_z_mm(x, y) - shift[2])
        places.append(x - shift[0] - glass.shear * (y - shift[1]))
    w, x, z = np.array(weights), np.array(places), np.array(heights)
    weight = w.sum(axis=0)
    middle, mean = (w * z).sum(axis=0) / weight, (w * x).sum(axis=0) / weight
    spread = (w * (z - middle) ** 2).sum(axis=0)
    rate = (w * (z - middle) * (x - mean)).sum(axis=0) / spread
    single = (w > 0).sum(axis=0) < 2
    lowest = np.where(w > 0, z, np.inf).min(axis=0)
    return _Line(np.where(single, np.nan, mean - rate * middle), rate, weight, middle, spread, lowest, lit)


def _place(model: RigModel, glass: GlassMap, phase_rad: NDArray[Any], y_mm: Array) -> Array:
    """Place on the glass along x."""
    x = glass.shear * y_mm + glass.value(glass.place_mm, phase_rad, y_mm)
    if model.correction_rad is not None:
        corrected = phase_rad - model.correction_rad(x, y_mm)
        x = glass.shear * y_mm + glass.value(glass.place_mm, corrected, y_mm)
    if model.bow_mm is not None:
        x = x + model.bow_mm(x, y_mm) * glass.value(glass.lift, phase_rad, y_mm)
    return x
