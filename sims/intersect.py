"""Rays against patches and glass: compiled, exact to float64.

What the kernels take is records, not tuples of arrays: passing an array counts a reference, and two threads
that count the same references all the time hold each other up.
"""

import math

import numpy as np
from numpy.typing import NDArray

from sims.compiled import inner_kernel
from sims.objects import MOST_SEGMENTS
from sims.surfaces import Patch

Point = tuple[float, float, float]
MISS, WALL, TOP = 0, 1, 2
# A curved patch's surface is searched for its first crossing in this many equal parts of the ray inside it.
_PARTS = 16
# A ray that leaves a surface must have gone this far (mm) before it can meet that surface again.
_CLEAR_MM = 1e-6
# Upper bounds of heights lie this much higher: a ray must be outside a solid where it enters its bounds.
_CLEARANCE_MM = 0.01

# One patch; `edges` holds (a, b, c) of a x + b y <= c, `low` and `high` bound its body along its own z.
PATCH = np.dtype(
    [
        ("origin", "f8", (3,)),
        ("axes", "f8", (3, 3)),
        ("edges", "f8", (MOST_SEGMENTS + 3, 3)),
        ("sides", "i8"),
        ("slope", "f8", (2,)),
        ("curvature", "f8", (2,)),
        ("bump", "f8", (4,)),
        ("flat", "i8"),
        ("solid", "i8"),
        ("low", "f8"),
        ("high", "f8"),
        ("kind", "i8"),
        ("chequered", "i8"),
        ("reflectance", "f8"),
    ],
    align=True,
)


def pack_patches(patches: list[Patch]) -> NDArray[np.void]:
    """Make records of all patches."""
    records = np.zeros(len(patches), PATCH)
    for record, patch in zip(records, patches, strict=True):
        side = np.roll(patch.polygon, -1, axis=0) - patch.polygon
        normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / np.linalg.norm(side, axis=1)[:, None]
        record["edges"][: len(side)] = np.column_stack([normal, (normal * patch.polygon).sum(axis=1)])
        record["sides"] = len(side)
        low, high = patch.height_range_mm()
        record["solid"] = not math.isnan(patch.base_mm)
        record["low"] = patch.base_mm if record["solid"] else low
        record["high"] = high + _CLEARANCE_MM
        record["flat"] = patch.is_flat
        for name in ("origin", "axes", "slope", "curvature", "bump", "kind", "chequered", "reflectance"):
            record[name] = getattr(patch, name)
    return records


@inner_kernel
def height_at(p: np.void, x: float, y: float) -> Point:
    """Height and its two slopes of a patch's surface at (x, y) of its own frame."""
    cx, cy = p.curvature[0], p.curvature[1]
    root = math.sqrt(max(1.0 - cx * cx * x * x - cy * cy * y * y, 1e-12))
    # d/dx of (cx x^2 + cy y^2) / (1 + root), with d(root)/dx = -cx^2 x / root.
    sag = (cx * x * x + cy * y * y) / (1.0 + root)
    scale = sag / ((1.0 + root) * root)
    z = p.slope[0] * x + p.slope[1] * y + sag
    zx = p.slope[0] + 2.0 * cx * x / (1.0 + root) + scale * cx * cx * x
    zy = p.slope[1] + 2.0 * cy * y / (1.0 + root) + scale * cy * cy * y
    if p.bump[0] != 0.0:
        bx, by = x - p.bump[2], y - p.bump[3]
        w2 = p.bump[1] * p.bump[1]
        bump = p.bump[0] * math.exp(-(bx * bx + by * by) / (2.0 * w2))
        z += bump
        zx -= bump * bx / w2
        zy -= bump * by / w2
    return z, zx, zy


@inner_kernel
def _gap(p: np.void, o: Point, d: Point, t: float) -> tuple[float, float]:
    """Height of the ray over the surface, and its growth along the ray."""
    z, zx, zy = height_at(p, o[0] + t * d[0], o[1] + t * d[1])
    return o[2] + t * d[2] - z, d[2] - zx * d[0] - zy * d[1]


@inner_kernel
def _root(p: np.void, o: Point, d: Point, low: float, high: float) -> float:
    """Where the gap between ray and surface goes from positive (`low`) to negative (`high`): safe Newton."""
    t = 0.5 * (low + high)
    for _ in range(80):
        gap, slope = _gap(p, o, d, t)
        if gap > 0.0:
            low = t
        else:
            high = t
        following = t - gap / slope if slope != 0.0 else low
        if abs(following - t) <= 4e-16 * abs(t):
            return following
        t = following if low < following < high else 0.5 * (low + high)
    return t


@inner_kernel
def _turned(axes: NDArray[np.float64], x: float, y: float, z: float) -> Point:
    return (
        axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z,
        axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z,
        axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z,
    )


@inner_kernel
def meet_patch(p: np.void, origin: Point, way: Point, start: float) -> tuple[float, int]:
    """First meeting, at t >= start, of the ray origin + t way with a patch: (t, MISS | WALL | TOP)."""
    o = _turned(p.axes, origin[0] - p.origin[0], origin[1] - p.origin[1], origin[2] - p.origin[2])
    d = _turned(p.axes, way[0], way[1], way[2])
    enter, leave = start, np.inf
    if p.solid:
        if d[2] != 0.0:
            first, second = (p.low - o[2]) / d[2], (p.high - o[2]) / d[2]
            enter, leave = max(enter, min(first, second)), max(first, second)
        elif not p.low <= o[2] <= p.high:
            return np.inf, MISS
    for e in range(p.sides):
        along = p.edges[e, 0] * d[0] + p.edges[e, 1] * d[1]
        room = p.edges[e, 2] - p.edges[e, 0] * o[0] - p.edges[e, 1] * o[1]
        if along > 0.0:
            leave = min(leave, room / along)
        elif along < 0.0:
            enter = max(enter, room / along)
        elif room < 0.0:
            return np.inf, MISS
        if enter > leave:
            return np.inf, MISS
    if not p.flat:
        return _meet_curved(p, o, d, enter, leave)
    if p.solid:
        gap, _ = _gap(p, o, d, enter)
        if gap <= 0.0:
            return enter, WALL
    rise = d[2] - p.slope[0] * d[0] - p.slope[1] * d[1]
    if rise == 0.0:
        return np.inf, MISS
    t = (p.slope[0] * o[0] + p.slope[1] * o[1] - o[2]) / rise
    if enter <= t <= leave:
        return t, TOP
    return np.inf, MISS


@inner_kernel
def _meet_curved(p: np.void, o: Point, d: Point, enter: float, leave: float) -> tuple[float, int]:
    gap, _ = _gap(p, o, d, enter)
    if gap <= 0.0:
        return enter, WALL
    low = enter
    for part in range(1, _PARTS + 1):
        high = enter + (leave - enter) * part / _PARTS
        gap, _ = _gap(p, o, d, high)
        if gap <= 0.0:
            return _root(p, o, d, low, high), TOP
        low = high
    return np.inf, MISS


@inner_kernel
def normal_at(p: np.void, point: Point) -> Point:
    """Find the unit normal, in frame M, of a patch at a point of its surface."""
    a = p.axes
    x, y, _ = _turned(a, point[0] - p.origin[0], point[1] - p.origin[1], point[2] - p.origin[2])
    _, zx, zy = height_at(p, x, y)
    scale = 1.0 / math.sqrt(1.0 + zx * zx + zy * zy)
    return (
        scale * (a[2, 0] - zx * a[0, 0] - zy * a[1, 0]),
        scale * (a[2, 1] - zx * a[0, 1] - zy * a[1, 1]),
        scale * (a[2, 2] - zx * a[0, 2] - zy * a[1, 2]),
    )


@inner_kernel
def is_shaded(patches: NDArray[np.void], source: int, origin: Point, way: Point, end: float) -> bool:
    """Whether a solid stops the ray that leaves patch `source` before it has gone `end`."""
    for k in range(patches.size):
        p = patches[k]
        # A flat solid is convex: what leaves its top never meets it again.
        if p.solid and not (k == source and p.flat):
            t, what = meet_patch(p, origin, way, _CLEAR_MM)
            if what != MISS and t < end:
                return True
    return False


@inner_kernel
def meet_glass(g: np.void, origin: Point, way: Point) -> tuple[float, Point]:
    """Distance to the glass (infinity: none) and its normal there, which points to the projector's side."""
    nowhere = (0.0, 0.0, 0.0)
    if not g.glass_present:
        return np.inf, nowhere
    a, c = g.glass_axes, g.glass_centre
    o = _turned(a, origin[0] - c[0], origin[1] - c[1], origin[2] - c[2])
    d = _turned(a, way[0], way[1], way[2])
    if d[2] == 0.0:
        return np.inf, nowhere
    half_x, half_y = g.glass_half[0], g.glass_half[1]
    bx, by = g.glass_bow / (half_x * half_x), g.glass_bow / (half_y * half_y)
    t = -o[2] / d[2]
    if g.glass_bow != 0.0:
        for _ in range(50):
            px, py = o[0] + t * d[0], o[1] + t * d[1]
            gap = o[2] + t * d[2] - bx * px * px - by * py * py
            step = gap / (d[2] - 2.0 * bx * px * d[0] - 2.0 * by * py * d[1])
            t -= step
            if abs(step) <= 4e-16 * abs(t):
                break
    px, py = o[0] + t * d[0], o[1] + t * d[1]
    # Not-a-number (Newton lost far outside the glass) fails these comparisons too.
    if not (t > _CLEAR_MM and abs(px) <= half_x and abs(py) <= half_y):
        return np.inf, nowhere
    nx, ny = -2.0 * bx * px, -2.0 * by * py
    scale = 1.0 / math.sqrt(1.0 + nx * nx + ny * ny)
    return t, (
        scale * (nx * a[0, 0] + ny * a[1, 0] + a[2, 0]),
        scale * (nx * a[0, 1] + ny * a[1, 1] + a[2, 1]),
        scale * (nx * a[0, 2] + ny * a[1, 2] + a[2, 2]),
    )
