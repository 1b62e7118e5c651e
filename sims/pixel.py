"""One camera ray through the whole world: compiled."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sims.compiled import inner_kernel
from sims.intersect import MISS, TOP, is_shaded, meet_glass, meet_patch, normal_at
from sims.projection import LENS_NUMBERS, projector_pixel
from sims.surfaces import DIFFUSE, GLASS, NONE, SPECULAR
from sims.texture import Scratch, mean_albedo

Array = NDArray[np.float64]
Point = tuple[float, float, float]
_NOWHERE = (np.nan, np.nan, np.nan)

# Everything that a ray can meet but the patches, in frame M; positions in mm, axes as rows.
SCENE = np.dtype(
    [
        ("camera_position", "f8", (3,)),
        ("camera_axes", "f8", (3, 3)),
        ("glass_present", "i8"),
        ("glass_centre", "f8", (3,)),
        ("glass_axes", "f8", (3, 3)),
        ("glass_half", "f8", (2,)),
        ("glass_bow", "f8"),
        ("transmission", "f8"),
        ("backscatter", "f8"),
        ("projector_position", "f8", (3,)),
        ("projector_axes", "f8", (3, 3)),
        ("lens", "f8", (LENS_NUMBERS,)),
        # The checkerboard: squares along x and y, their side and the border in mm, albedos.
        ("columns", "i8"),
        ("rows", "i8"),
        ("side", "f8"),
        ("border", "f8"),
        ("white", "f8"),
        ("black", "f8"),
    ],
    align=True,
)


class Hit(NamedTuple):
    """What a pixel sees; the fields are those of `sims.optics.Trace`."""

    kind: int
    facet: int
    point: Point
    normal: Point
    lit: Point
    column: float
    row: float
    factor: float
    lamp: float


@inner_kernel
def _along(origin: Point, way: Point, t: float) -> Point:
    return origin[0] + t * way[0], origin[1] + t * way[1], origin[2] + t * way[2]


@inner_kernel
def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner_kernel
def _in_m(axes: Array, x: float, y: float, z: float) -> Point:
    return (
        axes[0, 0] * x + axes[1, 0] * y + axes[2, 0] * z,
        axes[0, 1] * x + axes[1, 1] * y + axes[2, 1] * z,
        axes[0, 2] * x + axes[1, 2] * y + axes[2, 2] * z,
    )


@inner_kernel
def _lighting(scene: np.void, point: Point, normal: Point) -> Point:
    """Projector pixel that lights a point, and what the projector's radiant intensity makes of its radiance.

    The latter for a white Lambertian surface: cosine of incidence over pi and distance squared.
    """
    s, a = scene.projector_position, scene.projector_axes
    x, y, z = point[0] - s[0], point[1] - s[1], point[2] - s[2]
    column, row = projector_pixel(
        scene.lens,
        a[0, 0] * x + a[0, 1] * y + a[0, 2] * z,
        a[1, 0] * x + a[1, 1] * y + a[1, 2] * z,
        a[2, 0] * x + a[2, 1] * y + a[2, 2] * z,
    )
    distance2 = x * x + y * y + z * z
    cosine = -(x * normal[0] + y * normal[1] + z * normal[2]) / math.sqrt(distance2)
    if math.isnan(column) or cosine <= 0.0:
        return np.nan, np.nan, 0.0
    return column, row, cosine / (math.pi * distance2)


@inner_kernel
def _on_sheet(scene: np.void, p: np.void, x: float, y: float) -> tuple[float, float]:
    """Where the camera's direction (x, y, 1) meets a sheet's plane, in the sheet's frame."""
    way = _in_m(scene.camera_axes, x, y, 1.0)
    dx = scene.camera_position[0] - p.origin[0]
    dy = scene.camera_position[1] - p.origin[1]
    dz = scene.camera_position[2] - p.origin[2]
    height = p.axes[2, 0] * dx + p.axes[2, 1] * dy + p.axes[2, 2] * dz
    t = -height / (p.axes[2, 0] * way[0] + p.axes[2, 1] * way[1] + p.axes[2, 2] * way[2])
    dx, dy, dz = dx + t * way[0], dy + t * way[1], dz + t * way[2]
    return (
        p.axes[0, 0] * dx + p.axes[0, 1] * dy + p.axes[0, 2] * dz,
        p.axes[1, 0] * dx + p.axes[1, 1] * dy + p.axes[1, 2] * dz,
    )


@inner_kernel
def _footprint_albedo(scene: np.void, p: np.void, rays: Array, v: int, u: int, scratch: Scratch) -> float:
    """Mean albedo of a chequered sheet over the whole pixel; its corners follow from its neighbours."""
    left, right = max(u - 1, 0), min(u + 1, rays.shape[1] - 1)
    above, below = max(v - 1, 0), min(v + 1, rays.shape[0] - 1)
    across, down = 0.5 / (right - left), 0.5 / (below - above)
    ux, uy = across * (rays[v, right, 0] - rays[v, left, 0]), across * (rays[v, right, 1] - rays[v, left, 1])
    vx, vy = down * (rays[below, u, 0] - rays[above, u, 0]), down * (rays[below, u, 1] - rays[above, u, 1])
    x, y = rays[v, u, 0], rays[v, u, 1]
    quad = (
        _on_sheet(scene, p, x - ux - vx, y - uy - vy),
        _on_sheet(scene, p, x + ux - vx, y + uy - vy),
        _on_sheet(scene, p, x + ux + vx, y + uy + vy),
        _on_sheet(scene, p, x - ux + vx, y - uy + vy),
    )
    return mean_albedo(scene, p.reflectance, quad, scratch)


@inner_kernel
def trace_pixel(scene: np.void, patches: NDArray[np.void], rays: Array, v: int, u: int, scratch: Scratch) -> Hit:
    """Find what the ray of pixel (v, u) meets first, and the projector's light on its further way."""
    eye = (scene.camera_position[0], scene.camera_position[1], scene.camera_position[2])
    x, y = rays[v, u, 0], rays[v, u, 1]
    scale = 1.0 / math.sqrt(x * x + y * y + 1.0)
    way = _in_m(scene.camera_axes, scale * x, scale * y, scale)

    nearest, facet, what = np.inf, -1, MISS
    for k in range(patches.size):
        t, met = meet_patch(patches[k], eye, way, 0.0)
        if met != MISS and t < nearest:
            nearest, facet, what = t, k, met

    glass, glass_normal = meet_glass(scene, eye, way)
    if glass < nearest:
        return _glass_seen(scene, _along(eye, way, glass), glass_normal, way)
    if what != TOP:
        return Hit(NONE, -1, _NOWHERE, _NOWHERE, _NOWHERE, np.nan, np.nan, 0.0, 0.0)
    point = _along(eye, way, nearest)
    normal = normal_at(patches[facet], point)
    if patches[facet].kind == SPECULAR:
        return _mirror_seen(scene, patches, facet, point, normal, way)
    albedo = patches[facet].reflectance
    if patches[facet].chequered:
        albedo = _footprint_albedo(scene, patches[facet], rays, v, u, scratch)
    return _diffuse_seen(scene, patches, facet, point, normal, albedo)


@inner_kernel
def _glass_seen(scene: np.void, point: Point, normal: Point, way: Point) -> Hit:
    column, row, factor = _lighting(scene, point, normal)
    scatter = scene.backscatter if _dot(way, normal) < 0.0 else scene.transmission
    return Hit(GLASS, -1, point, normal, point, column, row, scatter * factor, scatter / math.pi)


@inner_kernel
def _mirror_seen(scene: np.void, patches: NDArray[np.void], facet: int, point: Point, normal: Point, way: Point) -> Hit:
    turned = _along(way, normal, -2.0 * _dot(way, normal))
    glass, glass_normal = meet_glass(scene, point, turned)
    if glass == np.inf or is_shaded(patches, facet, point, turned, glass):
        return Hit(SPECULAR, facet, point, normal, _NOWHERE, np.nan, np.nan, 0.0, 0.0)
    lit = _along(point, turned, glass)
    column, row, factor = _lighting(scene, lit, glass_normal)
    scatter = scene.transmission if _dot(turned, glass_normal) > 0.0 else scene.backscatter
    reflected = scatter * patches[facet].reflectance
    return Hit(SPECULAR, facet, point, normal, lit, column, row, reflected * factor, 0.0)


@inner_kernel
def _diffuse_seen(
    scene: np.void, patches: NDArray[np.void], facet: int, point: Point, normal: Point, albedo: float
) -> Hit:
    s = scene.projector_position
    x, y, z = s[0] - point[0], s[1] - point[1], s[2] - point[2]
    distance = math.sqrt(x * x + y * y + z * z)
    toward = (x / distance, y / distance, z / distance)
    glass, _ = meet_glass(scene, point, toward)
    if glass < distance or is_shaded(patches, facet, point, toward, distance):
        return Hit(DIFFUSE, facet, point, normal, point, np.nan, np.nan, 0.0, albedo / math.pi)
    column, row, factor = _lighting(scene, point, normal)
    return Hit(DIFFUSE, facet, point, normal, point, column, row, albedo * factor, albedo / math.pi)
