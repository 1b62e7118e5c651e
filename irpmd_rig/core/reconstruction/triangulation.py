"""Depth by triangulation: where the viewing ray meets the ray along which the light came from the glass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.reconstruction._kernel_parts import Pixels, Results, Rig, Smooth, Table
from irpmd_rig.core.reconstruction._triangulation_kernel import Ways, triangulate_pixels
from irpmd_rig.core.reconstruction._two_views_kernel import triangulate_two_views
from irpmd_rig.core.reconstruction.glass_map import GlassMap, powers, tabulate
from irpmd_rig.core.reconstruction.smooth_regions import smooth_regions
from irpmd_rig.core.reconstruction.surface_slope import Cells, cell_px
from irpmd_rig.core.reconstruction.views import DepthMap, Map, Views
from irpmd_rig.core.rig_model import Correction, RigModel

Kind = np.dtype[Any]

_BAND_ROWS = 128
_BAND_PX = 32_768
# What the rounds of the place across may leave, as a part of the height (float32 holds no more), and what a round
# leaves, in skews of the map. One round more where the rows' phases tell it, which come without a slope to begin with.
_LEFT = {np.dtype(np.float32): 2e-5, np.dtype(np.float64): 3e-9}
_LEFT_OF_SKEW = 2.0
_FEWEST_ROUNDS, _MOST_ROUNDS = 2, 12
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
    tables = rig_tables(model, np.result_type(*views.phases_rad).type) if tables is None else tables
    _check_window(views, tables)
    if not slope_rounds:
        return _solved(views, tables)
    if views.phases_y_rad is not None:
        return _solved(views, tables, with_slopes=True)
    return _solved(views, tables, _slopes(views, tables, slope_rounds), with_slopes=True)


def _slopes(views: Views, tables: RigTables, rounds: int) -> NDArray[np.float32]:
    """Slope across of every pixel, by triangulation of the mean phases of small cells, round by round."""
    rays = tables.rays_x[views.window], tables.rays_y[views.window]
    camera = tables.model.frame.camera_mm
    cells = Cells(smooth_regions(views), cell_px(*(abs(camera[2]) * values for values in rays)))
    seen = RigTables(tables.model, cells.means(rays[0]), cells.means(rays[1]), tables.along_x, tables.along_y)
    whole = tuple(slice(0, size) for size in cells.regions.shape)
    few = replace(
        views,
        phases_rad=tuple(cells.means(phase) for phase in views.phases_rad),
        sigmas_rad=tuple(cells.means(sigma) for sigma in views.sigmas_rad),
        window=(whole[0], whole[1]),
    )
    slope: Map | None = None
    for _ in range(rounds):
        depth = _solved(few, seen, slope).depth_mm.astype(np.float64)
        fit = cells.fit(*seen.points_mm(depth, few.window), depth)
        slope = fit.slope
    return cells.spread(fit, *rays, depth - camera[2], (float(camera[0]), float(camera[1])))


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


def _solved(views: Views, tables: RigTables, slopes: Map | None = None, *, with_slopes: bool = False) -> DepthMap:
    """Depth with the surface's slope across as given, or level; in bands of rows, copied where they lie apart."""
    kind = np.result_type(*views.phases_rad)
    place, ways = _Place.of(views, tables, kind), _ways(views, tables, kind)
    height, width = views.shape
    maps = [np.empty((height, width), kind) for _ in range(4 if with_slopes else 2)]
    rows, columns = views.window
    band = max(1, _BAND_PX // width)
    for top in range(0, height, band):
        part = slice(top, min(top + band, height))
        seen = slice(rows.start + part.start, rows.start + part.stop), columns
        pixels = _pixels(views, part, (tables.rays_x[seen], tables.rays_y[seen]), slopes, kind)
        found = [values[part].reshape(-1) for values in maps]
        results = Results(*found) if with_slopes else Results(*found, *np.empty((2, 0), kind))
        if len(views.positions_mm) == 2 and not (ways.across or ways.bowed or ways.corrected):
            triangulate_two_views(pixels, place.along_x, place.rig, ways.rounds, results)
        else:
            triangulate_pixels(pixels, place.along_x, place.along_y, place.rig, ways, results)
    return DepthMap(*(values.astype(np.float32, copy=False) for values in maps))


def _pixels(views: Views, rows: slice, rays: tuple[Map, Map], slopes: Map | None, kind: Kind) -> Pixels:
    """What is given of some rows of the window."""

    def flat(values: Map) -> Map:
        return np.ascontiguousarray(values, dtype=kind).reshape(-1)

    def stacked(maps: tuple[Map, ...]) -> Map:
        return np.stack([values[rows] for values in maps], dtype=kind).reshape(len(maps), -1)

    phases = stacked(views.phases_rad)
    return Pixels(
        phases,
        phases if views.phases_y_rad is None else stacked(views.phases_y_rad),
        stacked(views.sigmas_rad),
        flat(rays[0]),
        flat(rays[1]),
        np.empty(0, kind) if slopes is None else flat(slopes[rows]),
    )


def _ways(views: Views, tables: RigTables, kind: Kind) -> Ways:
    return Ways(
        across=views.phases_y_rad is not None,
        bowed=tables.model.bow_mm is not None,
        corrected=tables.model.correction_rad is not None,
        rounds=_rounds(tables.along_x, kind) + (views.phases_y_rad is not None),
    )


def _rounds(glass: GlassMap, kind: Kind) -> int:
    """Rounds of the place across: each shrinks what is left by about the skew of the map."""
    shrink = _LEFT_OF_SKEW * glass.skew
    if not 0 < shrink < 1:
        return _MOST_ROUNDS if shrink else _FEWEST_ROUNDS
    return int(np.clip(np.ceil(np.log(_LEFT[kind]) / np.log(shrink)), _FEWEST_ROUNDS, _MOST_ROUNDS))


def _table(glass: GlassMap, kind: Kind) -> Table:
    number = kind.type
    return Table(
        number(glass.along_rad[0]),
        number(1 / glass.along_rad[1]),
        number(glass.across_mm[0]),
        number(1 / glass.across_mm[1]),
        number(glass.shear),
        glass.coarse_mm.astype(kind),
        glass.place_mm.astype(kind),
        glass.lift.astype(kind),
        number(glass.mm_per_rad**2),
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
