"""The methods of reconstruction, pixel by pixel: a depth map each, and how uncertain quantities move it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Facets, Intrinsics, ReferenceFrame, depth_influences, rays
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.reconstruction.generalised import generalised_depth
from irpmd_rig.core.reconstruction.glass_map import GlassMap
from irpmd_rig.core.reconstruction.phase_filter import filter_phase
from irpmd_rig.core.reconstruction.triangulation import RigTables, triangulate
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.depth import depth_map, windowed
from irpmd_rig.processing.errors import FramesUnusable, Refused
from irpmd_rig.processing.evaluate import Change, facet_means
from irpmd_rig.processing.object_views import ObjectViews
from irpmd_rig.processing.optics import KnownRig, Optics, References
from irpmd_rig.processing.regions import Window, inside, overlap, within
from irpmd_rig.processing.stage_position import SIGMA_POSITION_MM

Array = NDArray[np.float64]

# Every so many pixels along rows and columns tell what another calibration would change, for it changes smoothly; less
# where that leaves a small facet too few.
_THIN_PX = 8
_FEWEST_PIXELS = 20
SIGMA_TRAVEL_MM = float(np.sqrt(2) * SIGMA_POSITION_MM)


@dataclass(frozen=True, slots=True, eq=False)
class PixelDepth:
    """A depth map of one method, and what tells how sure it is.

    Attributes
    ----------
    maps
        Depth and sigma in `window`.
    window
        Rows and columns of the picture.
    intrinsics, frame
        The camera, by which pixels become points.
    changes
        What uncertain quantities do to facets of the whole map.
    """

    maps: DepthMap
    window: Window
    intrinsics: Intrinsics
    frame: ReferenceFrame
    changes: Callable[[Facets], Sequence[Change]]

    def rays(self) -> NDArray[np.float64]:
        """Of the window's pixels, (h, w, 3); computed at each call."""
        return rays(windowed(self.intrinsics, self.window))

    def cut(self, part: Window) -> PixelDepth:
        """Give the rows and columns of the window that ``part`` names, counted from the window's first."""
        shape = self.maps.depth_mm.shape

        def changes(facets: Facets) -> Sequence[Change]:
            labels = np.zeros(shape, np.int32)
            labels[part] = facets.labels
            return self.changes(replace(facets, labels=labels))

        slopes = [None if slope is None else slope[part] for slope in (self.maps.slope_x, self.maps.slope_y)]
        maps = DepthMap(self.maps.depth_mm[part], self.maps.sigma_mm[part], *slopes)
        return replace(self, maps=maps, window=inside(part, self.window), changes=changes)


def depth_equation(
    optics: Optics, seen: ObjectViews, places: Sequence[int], *, filtered: bool, threads: int
) -> PixelDepth:
    """Depth by the paper's equation: stage positions as they read, d from the plate.

    Parameters
    ----------
    optics, seen
        Calibrations, and the object at two stage positions.
    places
        Of these positions in the reference.
    filtered
        Whether the object's phases are filtered first, within its facets.
    threads
        On which it is computed.

    Raises
    ------
    FramesUnusable
        If the object was not taken at two positions.
    Refused
        Without a reference.
    MeasurementError
        As `irpmd_rig.core.direct_depth`.
    """
    if len(seen.stations) != 2:
        raise FramesUnusable(
            f"the object was taken at {len(seen.stations)} stage positions; the depth equation takes two",
            "measure at two positions, or by another method",
        )
    window = overlap(seen.window, _references(optics).window)
    references = _reference_views(optics, places, window)
    views = replace(seen.cut(window).views(), positions_mm=seen.read_mm)
    views = filter_phase(views) if filtered else views
    # d holds where the geometry was calibrated; from there the stage takes mirror and camera away from the glass.
    d_mm = optics.geometry.d_mm + seen.read_mm[0] - optics.geometry_at_mm
    maps = depth_map(views, references, d_mm=d_mm, threads=threads)

    def changes(facets: Facets) -> list[Change]:
        influences = depth_influences(
            (*references.phases_rad, *views.phases_rad),
            maps.depth_mm,
            optics.geometry.frame,
            rays(windowed(optics.intrinsics, window)),
            d_mm=d_mm,
            sigma_d_mm=optics.geometry.sigma_d_mm,
            sigma_delta_d_mm=SIGMA_TRAVEL_MM,
        )
        means = {i.name: facet_means(i.change_mm, facets.labels, facets.count) for i in influences}
        return [Change("alignment" if i.kind == "alignment" else "calibration", means[i.name]) for i in influences]

    return PixelDepth(maps, window, optics.intrinsics, optics.geometry.frame, changes)


def triangulated(optics: Optics, seen: ObjectViews) -> PixelDepth:
    """Depth where the viewing ray meets the incident ray; raises Refused without a rig model."""
    rig = known_rig(optics)
    views = seen.views()
    maps = triangulate(views, rig.model, tables=rig.tables)

    def thin(tables: RigTables, positions_mm: tuple[float, ...], every: int) -> NDArray[np.float32]:
        few = replace(_thinned(views, every), positions_mm=positions_mm)
        return triangulate(few, tables.model, tables=tables, slope_rounds=0).depth_mm

    return _by_the_model(rig, seen, maps, thin)


def generalised(optics: Optics, seen: ObjectViews, places: Sequence[int]) -> PixelDepth:
    """Depth by the generalised equation on the calibrated points of the glass.

    Parameters
    ----------
    optics, seen, places
        As for `depth_equation`.

    Raises
    ------
    Refused
        Without a rig model or a reference.
    """
    rig = known_rig(optics)
    window = overlap(seen.window, _references(optics).window)
    references = _reference_views(optics, places, window)
    seen = seen.cut(window)
    views = seen.views()
    maps = generalised_depth(views, references, rig.model, tables=rig.tables)

    def thin(tables: RigTables, positions_mm: tuple[float, ...], every: int) -> NDArray[np.float32]:
        few, there = replace(_thinned(views, every), positions_mm=positions_mm), _thinned(references, every)
        if tables.model is not rig.model:
            # Another rig finds the reference's positions, too, from the glass: elsewhere by as much as the object's.
            moved = zip(there.positions_mm, positions_mm, views.positions_mm, strict=True)
            there = replace(there, positions_mm=tuple(at + other - own for at, other, own in moved))
        return generalised_depth(few, there, tables.model, tables=tables, slope_rounds=0).depth_mm

    return _by_the_model(rig, seen, maps, thin)


def known_rig(optics: Optics) -> KnownRig:
    """Give the rig model; raises Refused if the geometry was calibrated without."""
    if optics.rig is None:
        raise Refused("the calibration of the geometry has no rig model", "take it at several stage positions")
    return optics.rig


def _by_the_model(
    rig: KnownRig,
    seen: ObjectViews,
    maps: DepthMap,
    thin: Callable[[RigTables, tuple[float, ...], int], NDArray[np.float32]],
) -> PixelDepth:
    positions = seen.true_mm

    # `thin` takes surfaces for level along the fringes: few noisy pixels do not show their slope, and of surfaces that
    # are not level the depth is wrong before and after by the same.
    def changes(facets: Facets) -> list[Change]:
        every = _thinning(facets)
        labels = facets.labels[::every, ::every]
        own = _thin_tables(rig.model, (rig.tables.along_x, rig.tables.along_y), seen.window, every)
        here = thin(own, positions, every).astype(np.float64)

        def change(tables: RigTables, moved: tuple[float, ...]) -> Array:
            return facet_means(thin(tables, moved, every) - here, labels, facets.count)

        varied = zip(rig.variations, rig.varied_maps(), strict=True)
        tables = (_thin_tables(model, maps, seen.window, every) for model, maps in varied)
        found = [
            Change("calibration", change(other, tuple(np.add(positions, shifts).tolist())))
            for other, shifts in zip(tables, seen.shifts_mm(rig.variations), strict=True)
        ]
        for k, position in enumerate(seen.positions):
            moved = (*positions[:k], position.used_mm + position.sigma_mm, *positions[k + 1 :])
            found.append(Change("random", change(own, moved)))
        return found

    return PixelDepth(maps, seen.window, rig.model.intrinsics, rig.model.frame, changes)


def _thinning(facets: Facets) -> int:
    """How many pixels may stand for one such that every facet keeps enough of them."""
    every = _THIN_PX
    while every > 1:
        left = np.bincount(facets.labels[::every, ::every].ravel(), minlength=facets.count + 1)[1:]
        if left.min() >= _FEWEST_PIXELS:
            break
        every //= 2
    return every


def _thinned(views: Views, every: int) -> Views:
    few = np.s_[::every, ::every]
    phases = tuple(np.ascontiguousarray(phase[few]) for phase in views.phases_rad)
    height, width = phases[0].shape
    return Views(
        positions_mm=views.positions_mm,
        phases_rad=phases,
        sigmas_rad=tuple(np.ascontiguousarray(sigma[few]) for sigma in views.sigmas_rad),
        window=(slice(0, height), slice(0, width)),
        phases_y_rad=None
        if views.phases_y_rad is None
        else tuple(np.ascontiguousarray(phase[few]) for phase in views.phases_y_rad),
    )


def _thin_tables(model: RigModel, maps: tuple[GlassMap, GlassMap], window: Window, every: int) -> RigTables:
    """Tables of a rig for the pixels that `_thinned` leaves of a window."""
    rows, columns = (np.arange(side.start, side.stop, every, dtype=np.float64) for side in window)
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    directions = model.frame.directions(rays_at(model.intrinsics, pixels))
    slopes = (directions[..., :2] / directions[..., 2:]).astype(np.float32)
    return RigTables(model, slopes[..., 0], slopes[..., 1], *maps)


def _reference_views(optics: Optics, places: Sequence[int], window: Window) -> Views:
    """Phases of the reference mirror at some of its positions, in a window."""
    known = _references(optics)
    here = within(window, known.window)
    shape = window[0].stop - window[0].start, window[1].stop - window[1].start
    return Views(
        positions_mm=tuple(known.true_mm[place] for place in places),
        phases_rad=tuple(known.phases_rad[place][here] for place in places),
        sigmas_rad=tuple(np.full(shape, known.sigma_rad[place], np.float32) for place in places),
        window=window,
    )


def _references(optics: Optics) -> References:
    if optics.references is None:
        raise Refused("there is no reference", "make one at the same stage positions, and activate it")
    return optics.references
