"""The checkerboard's squares under a pixel: exact areas, because point samples would shift the corners."""

import numpy as np
from numpy.typing import NDArray

from sims.compiled import inner_kernel

Corner = tuple[float, float]
Quad = tuple[Corner, Corner, Corner, Corner]
Scratch = NDArray[np.float64]
# Two polygons; a quadrilateral that is cut four times has at most eight corners.
SCRATCH = (2, 16, 2)


@inner_kernel
def _clip(scratch: Scratch, source: int, count: int, axis: int, sign: float, limit: float) -> int:
    """Keep the part of a convex polygon where sign * coordinate <= limit (Sutherland and Hodgman).

    The polygon is `scratch[source]`; the part of it is written to the other half of the scratch space.
    """
    kept, target = 0, 1 - source
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here = limit - sign * scratch[source, i, axis]
        there = limit - sign * scratch[source, j, axis]
        if here >= 0.0:
            for c in range(2):
                scratch[target, kept, c] = scratch[source, i, c]
            kept += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            t = here / (here - there)
            for c in range(2):
                scratch[target, kept, c] = (1.0 - t) * scratch[source, i, c] + t * scratch[source, j, c]
            kept += 1
    return kept


@inner_kernel
def _area_in_box(quad: Quad, scratch: Scratch, box: tuple[float, float, float, float]) -> float:
    """Area of the quadrilateral inside box = (x low, x high, y low, y high)."""
    for i in range(4):
        scratch[0, i, 0], scratch[0, i, 1] = quad[i][0], quad[i][1]
    count = _clip(scratch, 0, 4, 0, -1.0, -box[0])
    count = _clip(scratch, 1, count, 0, 1.0, box[1])
    count = _clip(scratch, 0, count, 1, -1.0, -box[2])
    count = _clip(scratch, 1, count, 1, 1.0, box[3])
    twice = 0.0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        twice += scratch[0, i, 0] * scratch[0, j, 1] - scratch[0, j, 0] * scratch[0, i, 1]
    return 0.5 * abs(twice)


@inner_kernel
def mean_albedo(s: np.void, outside: float, quad: Quad, scratch: Scratch) -> float:
    """Mean albedo over a pixel's footprint, in the board's frame; `outside` is what surrounds it.

    `scratch` has the shape `SCRATCH`, and nothing in it is kept.
    """
    x0 = min(min(quad[0][0], quad[1][0]), min(quad[2][0], quad[3][0]))
    x1 = max(max(quad[0][0], quad[1][0]), max(quad[2][0], quad[3][0]))
    y0 = min(min(quad[0][1], quad[1][1]), min(quad[2][1], quad[3][1]))
    y1 = max(max(quad[0][1], quad[1][1]), max(quad[2][1], quad[3][1]))
    half_x, half_y = 0.5 * s.columns * s.side, 0.5 * s.rows * s.side
    i0, i1 = int(np.floor((x0 + half_x) / s.side)), int(np.floor((x1 + half_x) / s.side))
    j0, j1 = int(np.floor((y0 + half_y) / s.side)), int(np.floor((y1 + half_y) / s.side))
    if i0 == i1 and j0 == j1 and 0 <= i0 < s.columns and 0 <= j0 < s.rows:
        return s.black if (i0 + j0) % 2 == 0 else s.white
    board_x, board_y = half_x + s.border, half_y + s.border
    if x0 > board_x or x1 < -board_x or y0 > board_y or y1 < -board_y:
        return outside
    whole = _area_in_box(quad, scratch, (x0, x1, y0, y1))
    board = _area_in_box(quad, scratch, (-board_x, board_x, -board_y, board_y))
    black = 0.0
    for i in range(max(i0, 0), min(i1 + 1, s.columns)):
        for j in range(max(j0, 0), min(j1 + 1, s.rows)):
            if (i + j) % 2 == 0:
                left, low = i * s.side - half_x, j * s.side - half_y
                black += _area_in_box(quad, scratch, (left, left + s.side, low, low + s.side))
    return outside + ((s.white - outside) * board + (s.black - s.white) * black) / whole
