"""The truth of a setup: what every camera pixel sees, and which point of the projector lights it.

Conventions: frame M rides on stage1 with camera, mirror and objects; its z axis points from the reference
plane toward the glass. Pixel centres are at integers, columns u along x, rows v along y (physics notes,
sections 1, 2).
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sims.bands import over_rows
from sims.camera_rays import pixel_rays
from sims.compiled import kernel
from sims.frames import attitude, turn
from sims.intersect import pack_patches
from sims.pixel import SCENE, trace_pixel
from sims.projection import HEIGHT, WIDTH, lens_numbers, projector_frame
from sims.setup import Setup
from sims.surfaces import stage1_axis, subject_patches
from sims.texture import SCRATCH

if TYPE_CHECKING:
    from sims.world import World

Array = NDArray[np.float64]
# Steps of the fixed-point map: fine enough to be exact for every purpose of rendering, and two columns fit in
# 32 bits.
SUBPIXELS = 1 << 17


@dataclass(frozen=True, slots=True)
class Trace:
    """Exact truth at every camera pixel; float64, NaN where a quantity does not exist.

    Attributes
    ----------
    kind : (H, W) uint8
        0 nothing bright (background or a wall), 1 specular surface, 2 diffuse surface, 3 glass seen directly.
    facet : (H, W) int16
        Facet of the object in rising order; mirror: 0, its sprayed part 1; -1 where no facet is seen.
    point_mm : (H, W, 3)
        Point seen, in frame M.
    normal : (H, W, 3)
        Unit normal of the surface there, in frame M (glass: toward the projector's side).
    lit_mm : (H, W, 3)
        Point, in frame M, on which the projector's light for this pixel falls: on the glass for specular
        surfaces (NaN where the reflected ray misses the glass or is shaded), else the point seen.
    projector_px : (H, W, 2)
        Column and row of the projector that light that point; NaN where no projector light arrives.
    projector_factor_per_mm2 : (H, W)
        Radiance at the camera over the projector's radiant intensity; 0 where no projector light arrives.
    lamp_factor : (H, W)
        Radiance at the camera over the flood lamp's irradiance.
    """

    kind: NDArray[np.uint8]
    facet: NDArray[np.int16]
    point_mm: Array
    normal: Array
    lit_mm: Array
    projector_px: Array
    projector_factor_per_mm2: Array
    lamp_factor: Array


class LightMap(NamedTuple):
    """What rendering needs of a trace.

    `column` and `row` are fixed-point coordinates, in `SUBPIXELS` parts of half a projector pixel, on the
    grid of `sims.render.projected_light`; `factor` is float32 (0: no projector light), `lamp` too.
    """

    column: NDArray[np.int32]
    row: NDArray[np.int32]
    factor: NDArray[np.float32]
    lamp: NDArray[np.float32]


def trace(world: "World", setup: Setup) -> Trace:
    """Trace the centre of every camera pixel through the world.

    Parameters
    ----------
    world : World
    setup : Setup
        What stands where; the stages' displacements are true ones, without noise.

    Raises
    ------
    SimulationError
        The world has no such subject or board pose.
    """
    rays = pixel_rays(world.camera)
    scene, patches = scene_of(world, setup)
    shape = rays.shape[:2]
    vectors = [np.full((*shape, size), np.nan) for size in (3, 3, 3, 2)]
    result = Trace(np.zeros(shape, np.uint8), np.full(shape, -1, np.int16), *vectors, np.zeros(shape), np.zeros(shape))
    arrays = tuple(getattr(result, name) for name in Trace.__slots__)
    over_rows(lambda first, last: _trace_rows(scene, patches, rays, first, last, *arrays), shape[0])
    return result


def light_map(world: "World", setup: Setup) -> LightMap:
    """Trace for rendering: the same rays, kept at what a frame needs."""
    rays = pixel_rays(world.camera)
    scene, patches = scene_of(world, setup)
    shape = rays.shape[:2]
    result = LightMap(
        np.zeros(shape, np.int32),
        np.zeros(shape, np.int32),
        np.zeros(shape, np.float32),
        np.zeros(shape, np.float32),
    )
    over_rows(lambda first, last: _map_rows(scene, patches, rays, first, last, result), shape[0])
    return result


def scene_of(world: "World", setup: Setup) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Pack the whole geometry for the kernels, in frame M: one record of the scene, and the patches."""
    camera, glass, board = world.camera, world.glass, world.board
    moved, turned = setup.stage1_mm * stage1_axis(world.stage1), setup.glass_turn_deg
    projector_position, projector_axes = projector_frame(world.projector)
    scene = np.zeros(1, SCENE)
    values = {
        "camera_position": camera.position_mm,
        "camera_axes": attitude(camera.axis, camera.roll_deg),
        "glass_present": setup.glass,
        "glass_centre": np.array(glass.centre_mm) - moved,
        "glass_axes": turn(glass.tilt_about_x_deg + turned[0], glass.tilt_about_y_deg + turned[1]).T,
        "glass_half": np.array(glass.size_mm) / 2,
        "glass_bow": glass.bow_um * 1e-3,
        "transmission": glass.transmission,
        "backscatter": glass.backscatter,
        "projector_position": projector_position - moved,
        "projector_axes": projector_axes,
        "lens": lens_numbers(world.projector),
        "columns": board.squares[0],
        "rows": board.squares[1],
        "side": board.square_mm,
        "border": board.border_mm,
        "white": board.white_albedo,
        "black": board.black_albedo,
    }
    for name, value in values.items():
        scene[name] = value
    return scene, pack_patches(subject_patches(world, setup))


@kernel
def _trace_rows(
    scene: NDArray[np.void],
    patches: NDArray[np.void],
    rays: Array,
    first: int,
    last: int,
    kind: NDArray[np.uint8],
    facet: NDArray[np.int16],
    point: Array,
    normal: Array,
    lit: Array,
    pixel: Array,
    factor: Array,
    lamp: Array,
) -> None:
    scratch = np.empty(SCRATCH)
    for v in range(first, last):
        for u in range(rays.shape[1]):
            hit = trace_pixel(scene[0], patches, rays, v, u, scratch)
            kind[v, u] = hit.kind
            facet[v, u] = hit.facet
            for c in range(3):
                point[v, u, c] = hit.point[c]
                normal[v, u, c] = hit.normal[c]
                lit[v, u, c] = hit.lit[c]
            pixel[v, u, 0] = hit.column
            pixel[v, u, 1] = hit.row
            factor[v, u] = hit.factor
            lamp[v, u] = hit.lamp


@kernel
def _map_rows(
    scene: NDArray[np.void],
    patches: NDArray[np.void],
    rays: Array,
    first: int,
    last: int,
    out: LightMap,
) -> None:
    # Two samples a projector pixel, the first a quarter of a pixel inside its edge: x -> 2 x + 0.5.
    # A place on the last sample counts to the one before it: rendering reads two samples in each direction.
    last_part = SUBPIXELS - 1
    right = (int(2.0 * scene[0].lens[WIDTH]) - 2) * SUBPIXELS + last_part
    bottom = (int(2.0 * scene[0].lens[HEIGHT]) - 2) * SUBPIXELS + last_part
    scratch = np.empty(SCRATCH)
    for v in range(first, last):
        for u in range(rays.shape[1]):
            hit = trace_pixel(scene[0], patches, rays, v, u, scratch)
            out.lamp[v, u] = hit.lamp
            if hit.factor > 0.0:
                out.factor[v, u] = hit.factor
                column, row = 2.0 * hit.column + 0.5, 2.0 * hit.row + 0.5
                out.column[v, u] = min(max(int(np.floor(column * SUBPIXELS + 0.5)), 0), right)
                out.row[v, u] = min(max(int(np.floor(row * SUBPIXELS + 0.5)), 0), bottom)
