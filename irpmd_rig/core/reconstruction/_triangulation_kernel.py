"""The compiled kernel of the triangulation: loops over blocks of pixels that LLVM turns into vectors.

The rules are those of `irpmd_rig.core.phase._kernels`; one file again because of Numba's cache. What a block's loops
hand on lies in one array, at offsets that are constants: of many arrays LLVM would have to know that none overlaps
another, and gives up. All arithmetic has the type of the phases: every constant comes in as a value of that type,
since a literal would be float64.

At each stage position k the phase puts the lit point of the glass on a line across, x'_k(y_k), and the glass gives its
z_k. The points of all positions lie on the ray that leaves the surface, so x'_k = c + T z_k, and the viewing ray is
x' = x'_0 + w' z: the depth is where they meet. The coordinate across comes from the rows' phases, or else from the
law of reflection with the slope of the surface across.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.phase._wide_vectors import wide_vectors
from irpmd_rig.core.reconstruction._kernel_parts import (
    BLOCK,
    KERNEL,
    PITCH,
    SIMD,
    Pixels,
    Results,
    Rig,
    Smooth,
    Table,
    Values,
    lit,
    polynomial,
    surface_slope,
    terms,
)

_u = np.uintp
_SLOTS = 20
# Where the quantities of a block lie: the sums of the line fit ...
_S0, _SZ, _SZZ, _SX, _SXZ, _SY, _SYZ, _LOW = (_u(PITCH * k) for k in range(8))
# ... the point found and the ray that leaves it ...
_DEPTH, _TURNED, _UX, _UY, _SLOPE = (_u(PITCH * k) for k in range(8, 13))
# ... and of one view: the lit point, its place in the table and what comes out of it, and what the glass adds.
_X, _Y, _PHASE, _U, _V, _PLACE, _BOW = (_u(PITCH * k) for k in range(13, 20))


class Ways(NamedTuple):
    """What is to be done."""

    across: bool
    """The rows' phases are given too."""
    bowed: bool
    """The glass is no plane."""
    corrected: bool
    """The phase over the glass is not the projector's alone."""
    rounds: int


@njit(**SIMD)
def _horner(s: Values, c: Any, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_PHASE + i] = s[_PHASE + i] * s[_V + i] + c


@njit(**SIMD)
def _smooth(smooth: Smooth, s: Values, one: Any, n: int) -> None:
    """A correction of the glass at X and Y, of any degree: into PLACE."""
    wide_vectors()
    zero = one - one
    for i in range(_u(n)):
        s[_U + i] = min(max((s[_X + i] - smooth.x) * smooth.per_x_mm, -one), one)
        s[_V + i] = min(max((s[_Y + i] - smooth.y) * smooth.per_y_mm, -one), one)
        s[_PLACE + i] = zero
    c = smooth.coefficients
    for row in range(c.shape[0] - 1, -1, -1):
        for i in range(_u(n)):
            s[_PHASE + i] = zero
        for column in range(c.shape[1] - 1, -1, -1):
            _horner(s, c[row, column], n)
        for i in range(_u(n)):
            s[_PLACE + i] = s[_PLACE + i] * s[_U + i] + s[_PHASE + i]


@njit(**SIMD)
def _weigh(phase: Values, phase_y: Values, sigma: Values, weight: Values, one: Any, first: int, n: int) -> None:
    """Weight of a view's phases: 0 where one is unknown."""
    wide_vectors()
    zero = one - one
    for i in range(_u(n)):
        deviation = sigma[first + i]
        total = phase[first + i] + phase_y[first + i]
        known = (total - total == zero) & (deviation > zero)
        weight[i] = one / (deviation * deviation) if known else zero


@njit(**SIMD)
def _start(pixels: Pixels, one: Any, s: Values, first: int, n: int) -> None:
    """The ray that a mirror at height zero reflects."""
    wide_vectors()
    zero = one - one
    for i in range(_u(n)):
        s[_SLOPE + i] = zero
        s[_DEPTH + i] = zero
        s[_BOW + i] = zero
        s[_UX + i] = -pixels.rays_x[first + i]
        s[_UY + i] = -pixels.rays_y[first + i]
    if pixels.slopes.size:
        for i in range(_u(n)):
            slope = pixels.slopes[first + i]
            s[_SLOPE + i] = slope
            s[_UY + i] -= slope + slope


@njit(**SIMD)
def _clear(s: Values, one: Any, n: int) -> None:
    wide_vectors()
    zero = one - one
    for i in range(_u(n)):
        s[_S0 + i] = zero
        s[_SZ + i] = zero
        s[_SZZ + i] = zero
        s[_SX + i] = zero
        s[_SXZ + i] = zero
        s[_SY + i] = zero
        s[_SYZ + i] = zero
        s[_LOW + i] = one / zero


@njit(forceinline=True, **SIMD)
def _sum_up(s: Values, i: Any, w: Any, across: Any, z: Any, middle: Any, zero: Any) -> None:
    """Add a point to the sums of the line fit."""
    up = z - middle
    s[_S0 + i] += w
    s[_SZ + i] += w * up
    s[_SZZ + i] += w * up * up
    s[_SX + i] += w * across
    s[_SXZ + i] += w * up * across
    s[_LOW + i] = min(s[_LOW + i], z) if w > zero else s[_LOW + i]


@njit(**SIMD)
def _light(pixels: Pixels, shift: Any, rig: Rig, s: Values, first: int, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        seen = pixels.rays_x[first + i], pixels.rays_y[first + i]
        s[_X + i], s[_Y + i] = lit(rig, shift, s[_DEPTH + i], (s[_UX + i], s[_UY + i]), seen)


@njit(**SIMD)
def _bow(rig: Rig, s: Values, n: int) -> None:
    """Move the lit point to the bowed glass."""
    wide_vectors()
    _smooth(rig.bow, s, rig.one, n)
    for i in range(_u(n)):
        bow = s[_PLACE + i]
        s[_BOW + i] = bow
        s[_X + i] += s[_UX + i] * bow
        s[_Y + i] += s[_UY + i] * bow


@njit(**SIMD)
def _show(phase: Values, s: Values, first: int, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_PHASE + i] = phase[first + i]


@njit(**SIMD)
def _show_corrected(phase: Values, rig: Rig, s: Values, first: int, n: int) -> None:
    """The phase that the projector's model alone would give."""
    wide_vectors()
    _smooth(rig.correction, s, rig.one, n)
    for i in range(_u(n)):
        s[_PHASE + i] = phase[first + i] - s[_PLACE + i]


@njit(**SIMD)
def _across_is_x(table: Table, s: Values, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_V + i] = (s[_X + i] - table.across) * table.per_mm


@njit(**SIMD)
def _across_is_y(table: Table, s: Values, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_V + i] = (s[_Y + i] - table.across) * table.per_mm


@njit(**SIMD)
def _look_up(weight: Values, table: Table, bowed: bool, s: Values, zero: Any, n: int) -> None:
    """Place of a phase on the glass, less the shear, at V."""
    wide_vectors()
    for i in range(_u(n)):
        s[_U + i] = (s[_PHASE + i] - table.along) * table.per_rad if weight[i] > zero else zero
    if bowed:
        _bowed_place(terms(table.place), terms(table.lift), s, n)
    else:
        _plane_place(terms(table.place), s, n)


@njit(**SIMD)
def _plane_place(place: Any, s: Values, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_PLACE + i] = polynomial(place, s[_U + i], s[_V + i])


@njit(**SIMD)
def _bowed_place(place: Any, lift: Any, s: Values, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_PLACE + i] = polynomial(place, s[_U + i], s[_V + i]) + s[_BOW + i] * polynomial(lift, s[_U + i], s[_V + i])


@njit(**SIMD)
def _shear(table: Table, s: Values, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        s[_Y + i] = s[_PLACE + i] + table.shear * s[_X + i]


@njit(**SIMD)
def _add(weight: Values, pixels: Pixels, shift: Any, table: Table, rig: Rig, s: Values, first: int, n: int) -> None:
    """Add a view's point to the sums of the line fit."""
    wide_vectors()
    zero = rig.one - rig.one
    moved = shift[0] - table.shear * shift[1] + rig.camera_x - table.shear * rig.camera_y
    for i in range(_u(n)):
        place, y = s[_PLACE + i], s[_Y + i]
        z = rig.glass_a * (place + table.shear * y) + rig.glass_b * y + rig.glass_c + s[_BOW + i] - shift[2]
        across = place - moved + rig.camera_z * (pixels.rays_x[first + i] - table.shear * pixels.rays_y[first + i])
        s[_V + i] = z - rig.middle
        _sum_up(s, i, weight[i], across, z, rig.middle, zero)


@njit(**SIMD)
def _add_across(weight: Values, pixels: Pixels, shift: Any, rig: Rig, s: Values, first: int, n: int) -> None:
    """Add the coordinate across of the point that `_add` has added."""
    wide_vectors()
    moved = shift[1] + rig.camera_y
    for i in range(_u(n)):
        weighted = weight[i] * (s[_Y + i] - moved + rig.camera_z * pixels.rays_y[first + i])
        s[_SY + i] += weighted
        s[_SYZ + i] += s[_V + i] * weighted


@njit(**SIMD)
def _meet(pixels: Pixels, table: Table, rig: Rig, s: Values, first: int, n: int) -> None:
    """Depth from the sums, and the direction of the ray that leaves by the law of reflection."""
    wide_vectors()
    one = rig.one
    for i in range(_u(n)):
        wx, wy, q = pixels.rays_x[first + i], pixels.rays_y[first + i], s[_SLOPE + i]
        sx = s[_SX + i]
        per = one / s[_S0 + i]
        middle = s[_SZ + i] * per
        spread = s[_SZZ + i] - s[_SZ + i] * middle
        rate = (s[_SXZ + i] - sx * middle) / spread
        turn = rate - (wx - table.shear * wy)
        ux = rate + table.shear * s[_UY + i]
        # With g, the ratio of the lengths of (ux, uy, 1) and (wx, wy, 1): uy = -wy g - q (1 + g).
        t = wy + q
        a = one + wx * wx + wy * wy - t * t
        # One division for two.
        both = one / (a * turn)
        g = (q * t + np.sqrt(q * q * t * t + a * (one + ux * ux + q * q))) * (both * turn)
        s[_UX + i] = ux
        s[_UY + i] = -wy * g - q * (one + g)
        s[_DEPTH + i] = (rate * (rig.middle + middle) - sx * per) * (both * a)
        s[_TURNED + i] = turn * turn * table.precision


@njit(**SIMD)
def _meet_across(pixels: Pixels, table: Table, table_y: Table, rig: Rig, s: Values, first: int, n: int) -> None:
    """As `_meet`, where rows tell the place across: the nearest point of both rays."""
    wide_vectors()
    for i in range(_u(n)):
        wx, wy = pixels.rays_x[first + i], pixels.rays_y[first + i]
        sx, sy = s[_SX + i], s[_SY + i]
        per = rig.one / s[_S0 + i]
        middle = s[_SZ + i] * per
        spread = s[_SZZ + i] - s[_SZ + i] * middle
        rate, uy = (s[_SXZ + i] - sx * middle) / spread, (s[_SYZ + i] - sy * middle) / spread
        turn, turn_y = rate - (wx - table.shear * wy), uy - wy
        z = rig.middle + middle
        weight = turn * turn * table.precision + turn_y * turn_y * table_y.precision
        h = turn * (rate * z - sx * per) * table.precision + turn_y * (uy * z - sy * per) * table_y.precision
        s[_UX + i] = rate + table.shear * uy
        s[_UY + i] = uy
        s[_DEPTH + i] = h / weight
        s[_TURNED + i] = weight


@njit(**SIMD)
def _put(rig: Rig, s: Values, results: Results, first: int, n: int) -> None:
    """The depth and, from the line fit's variance at its height, the depth's sigma."""
    wide_vectors()
    zero = rig.one - rig.one
    for i in range(_u(n)):
        h, turned = s[_DEPTH + i], s[_TURNED + i]
        per = rig.one / s[_S0 + i]
        middle = s[_SZ + i] * per
        spread = s[_SZZ + i] - s[_SZ + i] * middle
        reach = h - rig.middle - middle
        variance = (per + reach * reach / spread) / turned
        known = (turned > rig.least_turn) & (spread > rig.least_spread * s[_S0 + i])
        # No surface lies behind the glass or the camera.
        known = known & (h < s[_LOW + i]) & (h < rig.camera_z) & (variance < rig.one / zero)
        results.depth[first + i] = h if known else rig.nan
        results.sigma[first + i] = np.sqrt(variance) if known else rig.nan


@njit(**SIMD)
def _put_slopes(pixels: Pixels, rig: Rig, s: Values, results: Results, first: int, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        known = results.depth[first + i] == results.depth[first + i]
        x, y = surface_slope(rig.one, (pixels.rays_x[first + i], pixels.rays_y[first + i]), (s[_UX + i], s[_UY + i]))
        results.slope_x[first + i] = x if known else rig.nan
        results.slope_y[first + i] = y if known else rig.nan


@njit(**SIMD)
def _view(
    k: int, weight: Values, pixels: Pixels, tables: Any, rig: Rig, ways: Ways, s: Values, first: int, n: int
) -> None:
    """Add a view's point on the glass to the sums of the line fit."""
    table, table_y = tables
    zero = rig.one - rig.one
    shift = (rig.shifts[k, 0], rig.shifts[k, 1], rig.shifts[k, 2])
    _light(pixels, shift, rig, s, first, n)
    if ways.bowed:
        _bow(rig, s, n)
    if ways.across:
        _show(pixels.phases_y[k], s, first, n)
        _across_is_x(table_y, s, n)
        _look_up(weight, table_y, ways.bowed, s, zero, n)
        _shear(table_y, s, n)
    if ways.corrected:
        _show_corrected(pixels.phases[k], rig, s, first, n)
    else:
        _show(pixels.phases[k], s, first, n)
    _across_is_y(table, s, n)
    _look_up(weight, table, ways.bowed, s, zero, n)
    _add(weight, pixels, shift, table, rig, s, first, n)
    if ways.across:
        _add_across(weight, pixels, shift, rig, s, first, n)


@njit(**SIMD)
def _round(pixels: Pixels, weights: Values, tables: Any, rig: Rig, ways: Ways, s: Values, first: int, n: int) -> None:
    """Sums over the views, with the places across that the last round found."""
    _clear(s, rig.one, n)
    for k in range(pixels.phases.shape[0]):
        _view(k, weights[k], pixels, tables, rig, ways, s, first, n)


@njit(**KERNEL)
def triangulate_pixels(pixels: Pixels, table: Table, table_y: Table, rig: Rig, ways: Ways, results: Results) -> None:
    """Depth and its sigma for all pixels."""
    kind, size = pixels.rays_x.dtype, pixels.rays_x.size
    s = np.empty(_SLOTS * PITCH, kind)
    weights = np.empty((pixels.phases.shape[0], BLOCK), kind)
    for begin in range(0, size, BLOCK):
        n = min(BLOCK, size - begin)
        first = _u(begin)
        for k in range(pixels.phases.shape[0]):
            _weigh(pixels.phases[k], pixels.phases_y[k], pixels.sigmas[k], weights[k], rig.one, first, n)
        _start(pixels, rig.one, s, first, n)
        for _ in range(ways.rounds):
            _round(pixels, weights, (table, table_y), rig, ways, s, first, n)
            if ways.across:
                _meet_across(pixels, table, table_y, rig, s, first, n)
            else:
                _meet(pixels, table, rig, s, first, n)
        _put(rig, s, results, first, n)
        if results.slope_x.size:
            _put_slopes(pixels, rig, s, results, first, n)


announce_compilation(triangulate_pixels, "the triangulation kernel")
