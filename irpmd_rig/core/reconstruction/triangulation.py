"""Depth by triangulation: where the viewing ray meets the ray along which the light came from the glass."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.reconstruction._triangulation_kernel import (
    Pixels,
    Results,
    Rig,
    Smooth,
    Table,
    Ways,
    triangulate_pixels,
)
from irpmd_rig.core.reconstruction.glass_map import GlassMap, powers, tabulate
from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.surface_slope import slope_across
from irpmd_rig.core.reconstruction.views import DepthMap, Map, Views
from irpmd_rig.core.rig_model import Correction, RigModel

Kind = np.dtype[Any]

_BAND_ROWS = 128
# Rounds of the place across: each gains two digits or more; float32 holds no more than three rounds give.
_ROUNDS = {np.dtype(np.float32): 3, np.dtype(np.float64): 6}
_LEAST_ANGLE = 1e-3
_LEAST_SPREAD = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class RigTables:
    """What triangulation needs of a rig, computed once: the rays of all pixels and the map of the glass.

    Attributes
    ----------
    model : RigModel
        The rig.
    rays_x, rays_y : ndarray, (H, W)
        dx/dz and dy/dz in M of the viewing rays.
    along_x, along_y : GlassMap
        Places on the glass by the phases along x and y.
    """

    model: RigModel
    rays_x: NDArray[np.floating[Any]]
    rays_y: NDArray[np.floating[Any]]
    along_x: GlassMap
    along_y: GlassMap

    def points_mm(self, depth_mm: Map, window: tuple[slice, slice]) -> tuple[Map, Map]:
        """Places x and y in M of the points seen at these depths, (h, w) each."""
        x, y, z = self.model.frame.camera_mm
        reach = depth_mm - z
        return x + reach * self.rays_x[window], y + reach * self.rays_y[window]


def rig_tables(model: RigModel, precision: type[np.floating[Any]] = np.float32) -> RigTables:
    """Compute the tables of a rig.

    Parameters
    ----------
    model : RigModel
        The calibrated rig.
    precision : type
        Of the rays: float32 (0.01 um of depth, and half the memory) or float64.

    Raises
    ------
    CalibrationError
        As `irpmd_rig.core.reconstruction.glass_map.tabulate`.
    """
    width, height = model.intrinsics.size_px
    rays = np.empty((2, height, width), precision)
    # In bands: the rays of a whole picture in float64 would take 100 MB on the way.
    for first in range(0, height, _BAND_ROWS):
        rows = np.arange(first, min(first + _BAND_ROWS, height))
        pixels = np.stack(np.meshgrid(np.arange(width), rows), axis=-1)
        directions = model.frame.directions(rays_at(model.intrinsics, pixels))
        for axis in (0, 1):
            rays[axis, rows] = directions[..., axis] / directions[..., 2]
    return RigTables(model, rays[0], rays[1], tabulate(model, 0), tabulate(model, 1))


def triangulate(views: Views, model: RigModel, *, tables: RigTables | None = None, slope_rounds: int = 2) -> DepthMap:
    """Depth of every pixel from its phases at two or more stage positions.

    Parameters
    ----------
    views : Views
        Phases of the object. A pixel is computed from the views that know its phase, two at least.
    model : RigModel
        The calibrated rig.
    tables : RigTables, optional
        Of the same model, to save their computation (a second at full size).
    slope_rounds : int
        How often the slope across is taken from the depth found before, where x fringes alone were shown. 0: the
        surface is taken to be level across, and slopes are not returned: the fastest way.

    Returns
    -------
    DepthMap
        NaN where fewer than two views know the phase, the viewing and the incident ray are parallel within 1 mrad, or
        the point would lie behind the glass or the camera. `slope_x` is measured; `slope_y` is so with y fringes,
        else it is the one taken from the depth.

    Raises
    ------
    FramesError
        If the views' window is not within the camera's picture.
    CalibrationError
        If the model's projector does not light its glass.

    Notes
    -----
    Physics notes, section 5. The lit points of the glass, one a position, lie on the ray that leaves the surface; a
    line fitted to them, weighted by the phases' sigmas, meets the viewing ray at the surface. Of x fringes alone both
    are seen in projection along the fringes: the slope of the surface across then enters through keystone and
    distortion of the projector only (7 um for 0.6 deg, 0.1 mm on a sphere of radius 100 with the projector 1 deg
    askew), and is taken from the depth itself, smoothed within regions free of jumps; two rounds leave 0.5 um rms
    on that sphere. Phases in float32 are computed in float32 (0.1 um), else in float64 (1e-4 um; 0.1 um
    with a glass bowed by 50 um).
    """
    kind = np.result_type(*views.phases_rad)
    tables = rig_tables(model, kind.type) if tables is None else tables
    _check_window(views, tables)
    pixels, ways, place = _given(views, tables, kind), _ways(views, model, kind), _Place.of(views, tables, kind)
    if not slope_rounds:
        return _solved(pixels, ways, place, views.shape, slopes=False)
    if ways.across:
        return _solved(pixels, ways, place, views.shape, slopes=True)
    regions = smooth_regions(views)
    found = _solved(pixels, ways, place, views.shape, slopes=False)
    for left in range(slope_rounds, 0, -1):
        slope = slope_across(found.depth_mm, *tables.points_mm(found.depth_mm, views.window), regions)
        pixels = pixels._replace(slopes=slope.astype(kind).reshape(-1))
        found = _solved(pixels, ways._replace(sloped=True), place, views.shape, slopes=left == 1)
    return found


@dataclass(frozen=True, slots=True)
class _Place:
    """The rig as the kernel takes it."""

    along_x: Table
    along_y: Table
    rig: Rig

    @staticmethod
    def of(views: Views, tables: RigTables, kind: Kind) -> _Place:
        model, number = tables.model, kind.type
        shifts = np.array(views.positions_mm)[:, None] * model.stage_axis
        a, b, c = model.glass
        # Heights are counted from about the middle of the glass at the middle position.
        lit_x, lit_y = tables.along_x.place_mm[0, 0], tables.along_y.place_mm[0, 0]
        heights = a * lit_x + b * lit_y + c - shifts[:, 2]
        x, y, z = model.frame.camera_mm
        rig = Rig(
            one=number(1.0),
            nan=number(np.nan),
            camera_x=number(x),
            camera_y=number(y),
            camera_z=number(z),
            glass_a=number(a),
            glass_b=number(b),
            glass_c=number(c),
            middle=number(heights.mean()),
            least_turn=number(_LEAST_ANGLE**2 / tables.along_x.mm_per_rad**2),
            least_spread=number(_LEAST_SPREAD * np.ptp(heights) ** 2),
            shifts=shifts.astype(kind),
            bow=_smooth(model.bow_mm, kind),
            correction=_smooth(model.correction_rad, kind),
        )
        return _Place(_table(tables.along_x, kind), _table(tables.along_y, kind), rig)


def _check_window(views: Views, tables: RigTables) -> None:
    rows, columns = views.window
    height, width = tables.rays_x.shape
    if not (0 <= rows.start < rows.stop <= height and 0 <= columns.start < columns.stop <= width):
        raise FramesError(f"the window {views.window} is not within the camera's picture of {height} x {width} pixels")


def _given(views: Views, tables: RigTables, kind: Kind) -> Pixels:
    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values, dtype=kind).reshape(-1)

    def stacked(maps: tuple[Map, ...]) -> NDArray[Any]:
        return np.stack(maps, dtype=kind).reshape(len(maps), -1)

    phases = stacked(views.phases_rad)
    return Pixels(
        phases,
        phases if views.phases_y_rad is None else stacked(views.phases_y_rad),
        stacked(views.sigmas_rad),
        flat(tables.rays_x[views.window]),
        flat(tables.rays_y[views.window]),
        np.empty(0, kind),
    )


def _ways(views: Views, model: RigModel, kind: Kind) -> Ways:
    corrected = model.bow_mm is not None or model.correction_rad is not None
    return Ways(views.phases_y_rad is not None, False, corrected, _ROUNDS[kind])


def _solved(pixels: Pixels, ways: Ways, place: _Place, shape: tuple[int, int], *, slopes: bool) -> DepthMap:
    size, kind = pixels.rays_x.size, pixels.rays_x.dtype
    depth, sigma = np.empty((2, size), kind)
    slope_x, slope_y = np.empty((2, size if slopes else 0), kind)
    results = Results(depth, sigma, slope_x, slope_y)
    triangulate_pixels(pixels, place.along_x, place.along_y, place.rig, ways, results, 0, size)
    depth, sigma, slope_x, slope_y = (values.astype(np.float32, copy=False) for values in results)
    if not slopes:
        return DepthMap(depth.reshape(shape), sigma.reshape(shape))
    return DepthMap(*(values.reshape(shape) for values in (depth, sigma, slope_x, slope_y)))


def _table(glass: GlassMap, kind: Kind) -> Table:
    number = kind.type
    return Table(
        number(glass.along_rad[0]),
        number(1 / glass.along_rad[1]),
        number(glass.across_mm[0]),
        number(1 / glass.across_mm[1]),
        number(glass.shear),
        glass.place_mm.astype(kind),
        glass.lift.astype(kind),
        number(1 / glass.mm_per_rad**2),
    )


def _smooth(correction: Correction | None, kind: Kind) -> Smooth:
    number = kind.type
    if correction is None:
        return Smooth(number(0), number(0), number(0), number(0), np.zeros((1, 1), kind))
    (left, right), (low, high) = correction.x_mm, correction.y_mm
    return Smooth(
        number((left + right) / 2),
        number(2 / (right - left)),
        number((low + high) / 2),
        number(2 / (high - low)),
        np.ascontiguousarray(powers(correction.coefficients), dtype=kind),
    )
