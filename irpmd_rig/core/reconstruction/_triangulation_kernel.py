"""The compiled kernel of the triangulation: loops over blocks of pixels that LLVM turns into vectors.

The rules are those of `irpmd_rig.core.phase._kernels`; one file again because of Numba's cache. All arithmetic has the
type of the phases: every constant comes in as a value of that type, since a literal would be float64.

At each stage position k the phase puts the lit point of the glass on a line across, x'_k(y_k), and the glass gives its
z_k. The points of all positions lie on the ray that leaves the surface, so x'_k = c + T z_k, and the viewing ray is
x' = x'_0 + w' z: the depth is where they meet. The coordinate across comes from the rows' phases, or else from the
law of reflection with the slope of the surface across.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.phase._wide_vectors import wide_vectors

Values = NDArray[Any]

BLOCK = 512
"""Pixels of a block: its sums stay in the first-level cache."""

_SIMD = {"fastmath": {"contract", "nsz"}, "error_model": "numpy", "nogil": True}
_KERNEL = {"cache": True, "error_model": "numpy", "nogil": True}
_u = np.uintp


class Table(NamedTuple):
    """`irpmd_rig.core.reconstruction.glass_map.GlassMap`, scaled for the kernel; scalars and arrays of one type."""

    along: Any
    per_rad: Any
    across: Any
    per_mm: Any
    shear: Any
    place: Values
    lift: Values
    precision: Any
    """1 / mm_per_rad^2: weight of a measured place."""


class Smooth(NamedTuple):
    """`irpmd_rig.core.rig_model.Correction` as powers c[i, j] x^i y^j; beyond -1..1 the edge's value holds."""

    x: Any
    per_x_mm: Any
    y: Any
    per_y_mm: Any
    coefficients: Values


class Rig(NamedTuple):
    """What is the same for all pixels."""

    one: Any
    nan: Any
    camera_x: Any
    camera_y: Any
    camera_z: Any
    glass_a: Any
    glass_b: Any
    glass_c: Any
    middle: Any
    """Height from which the glass's heights are counted."""
    least_turn: Any
    """Least square of the angle between the viewing and the incident ray, over that of a radian on the glass."""
    least_spread: Any
    """Least variance of the glass's heights over the views, mm^2."""
    shifts: Values
    """(K, 3): how far each view's points are moved to stand still."""
    bow: Smooth
    correction: Smooth


class Pixels(NamedTuple):
    """What is given of every pixel, flat; (views, pixels) or (pixels,)."""

    phases: Values
    phases_y: Values
    sigmas: Values
    rays_x: Values
    rays_y: Values
    """dx/dz and dy/dz of the viewing rays."""
    slopes: Values
    """Assumed dz/dy of the surface."""


class Ways(NamedTuple):
    """What is to be done."""

    across: bool
    """The rows' phases are given too."""
    sloped: bool
    """A slope across is given."""
    corrected: bool
    """The glass has a bow or a correction."""
    rounds: int


class Results(NamedTuple):
    """Flat results; the slopes may be empty."""

    depth: Values
    sigma: Values
    slope_x: Values
    slope_y: Values


@njit(**_SIMD)
def _powers(c: Values, u: Any, v: Any, one: Any) -> Any:
    """Polynomial sum c[j, i] v^j u^i of any degree."""
    rows, columns = c.shape
    total = one - one
    for j in range(rows - 1, -1, -1):
        row = one - one
        for i in range(columns - 1, -1, -1):
            row = row * u + c[j, i]
        total = total * v + row
    return total


@njit(**_SIMD)
def _polynomials(c: Values, u: Values, v: Values, place: Values, n: int) -> None:
    """Polynomial of degree 7: written out, since LLVM vectorises it only with the coefficients in registers."""
    wide_vectors()
    c00, c01, c02, c03, c04, c05, c06, c07 = c[0, 0], c[0, 1], c[0, 2], c[0, 3], c[0, 4], c[0, 5], c[0, 6], c[0, 7]
    c10, c11, c12, c13, c14, c15, c16 = c[1, 0], c[1, 1], c[1, 2], c[1, 3], c[1, 4], c[1, 5], c[1, 6]
    c20, c21, c22, c23, c24, c25 = c[2, 0], c[2, 1], c[2, 2], c[2, 3], c[2, 4], c[2, 5]
    c30, c31, c32, c33, c34 = c[3, 0], c[3, 1], c[3, 2], c[3, 3], c[3, 4]
    c40, c41, c42, c43 = c[4, 0], c[4, 1], c[4, 2], c[4, 3]
    c50, c51, c52 = c[5, 0], c[5, 1], c[5, 2]
    c60, c61 = c[6, 0], c[6, 1]
    c70 = c[7, 0]
    for i in range(_u(n)):
        s, t = u[i], v[i]
        total = c70
        total = total * t + (c61 * s + c60)
        total = total * t + ((c52 * s + c51) * s + c50)
        total = total * t + (((c43 * s + c42) * s + c41) * s + c40)
        total = total * t + ((((c34 * s + c33) * s + c32) * s + c31) * s + c30)
        total = total * t + (((((c25 * s + c24) * s + c23) * s + c22) * s + c21) * s + c20)
        total = total * t + ((((((c16 * s + c15) * s + c14) * s + c13) * s + c12) * s + c11) * s + c10)
        total = total * t + (((((((c07 * s + c06) * s + c05) * s + c04) * s + c03) * s + c02) * s + c01) * s + c00)
        place[i] = total


@njit(**_SIMD)
def _lines(c: Values, u: Values, place: Values, n: int) -> None:
    """What is linear in the phase alone: enough for a first guess."""
    wide_vectors()
    offset, rate = c[0, 0], c[0, 1]
    for i in range(_u(n)):
        place[i] = offset + rate * u[i]


@njit(**_SIMD)
def _smooth(s: Smooth, x: Any, y: Any, one: Any) -> Any:
    u = min(max((x - s.x) * s.per_x_mm, -one), one)
    v = min(max((y - s.y) * s.per_y_mm, -one), one)
    return _powers(s.coefficients, v, u, one)


@njit(**_SIMD)
def _weigh(phase: Values, phase_y: Values, sigma: Values, weight: Values, one: Any, first: int, n: int) -> None:
    """Weight of a view's phases: 0 where one is unknown."""
    wide_vectors()
    zero = one - one
    for i in range(_u(n)):
        s = sigma[first + i]
        total = phase[first + i] + phase_y[first + i]
        known = (total - total == zero) & (s > zero)
        weight[i] = one / (s * s) if known else zero


@njit(**_SIMD)
def _start(rays_y: Values, one: Any, first: int, sums: Values, n: int) -> None:
    """A level mirror at height zero."""
    wide_vectors()
    depth, leave_x, leave_y = sums[7], sums[9], sums[10]
    zero = one - one
    for i in range(_u(n)):
        depth[i] = zero
        leave_x[i] = zero
        leave_y[i] = -rays_y[first + i]


@njit(**_SIMD)
def _look_up(
    phase: Values, weight: Values, rays_x: Values, rays_y: Values, shift: Values, table: Table, rig: Rig,
    sums: Values, first: int, n: int,
) -> None:  # fmt: skip
    """What a view's place on the glass depends on: its phase, and the place across by the ray that leaves."""
    wide_vectors()
    depth, leave_x, leave_y, u, v = sums[7], sums[9], sums[10], sums[13], sums[14]
    zero = rig.one - rig.one
    shift_x, shift_y, shift_z = shift[0], shift[1], shift[2]
    for i in range(_u(n)):
        h, ux, uy = depth[i], leave_x[i], leave_y[i]
        x = rig.camera_x + (h - rig.camera_z) * rays_x[first + i] - ux * h + shift_x
        y = rig.camera_y + (h - rig.camera_z) * rays_y[first + i] - uy * h + shift_y
        e = rig.glass_a * ux + rig.glass_b * uy
        # 1 / (1 - e), e being the glass's tilt: far more than what the place across needs.
        z = (rig.glass_a * x + rig.glass_b * y + rig.glass_c - shift_z) * (rig.one + e + e * e)
        v[i] = (y + uy * z - table.across) * table.per_mm
        u[i] = (phase[first + i] - table.along) * table.per_rad if weight[i] > zero else zero


@njit(**_SIMD)
def _add_view(
    weight: Values, rays_x: Values, rays_y: Values, shift: Values, table: Table, rig: Rig, sums: Values, first: int,
    n: int,
) -> None:  # fmt: skip
    """Add a view's point on the glass to the sums of the line fit."""
    wide_vectors()
    s0, sz, szz, sx, sxz, low, v, place = sums[0], sums[1], sums[2], sums[3], sums[4], sums[6], sums[14], sums[15]
    zero = rig.one - rig.one
    moved = shift[0] - table.shear * shift[1] + rig.camera_x - table.shear * rig.camera_y
    shift_z = shift[2]
    width = rig.one / table.per_mm
    for i in range(_u(n)):
        w = weight[i]
        y = table.across + v[i] * width
        z = rig.glass_a * (place[i] + table.shear * y) + rig.glass_b * y + rig.glass_c - shift_z
        across = place[i] - moved + rig.camera_z * (rays_x[first + i] - table.shear * rays_y[first + i])
        up = z - rig.middle
        s0[i] += w
        sz[i] += w * up
        szz[i] += w * up * up
        sx[i] += w * across
        sxz[i] += w * up * across
        low[i] = min(low[i], z) if w > zero else low[i]


@njit(**_SIMD)
def _add_corrected_view(
    phase: Values, phase_y: Values, weight: Values, rays_x: Values, rays_y: Values, shift: Values, across_known: bool,
    table: Table, table_y: Table, rig: Rig, sums: Values, first: int, n: int,
) -> None:  # fmt: skip
    """As `_add_view`, with the rows' phases, a bowed glass and a corrected phase."""
    s0, sz, szz, sx, sxz, low = sums[0], sums[1], sums[2], sums[3], sums[4], sums[6]
    depth, leave_x, leave_y, sy, syz = sums[7], sums[9], sums[10], sums[11], sums[12]
    zero = rig.one - rig.one
    shift_x, shift_y, shift_z = shift[0], shift[1], shift[2]
    for i in range(_u(n)):
        w, h, ux, uy = weight[i], depth[i], leave_x[i], leave_y[i]
        wx, wy = rays_x[first + i], rays_y[first + i]
        x0 = rig.camera_x + (h - rig.camera_z) * wx - ux * h + shift_x
        y0 = rig.camera_y + (h - rig.camera_z) * wy - uy * h + shift_y
        e = rig.glass_a * ux + rig.glass_b * uy
        z = (rig.glass_a * x0 + rig.glass_b * y0 + rig.glass_c - shift_z) * (rig.one + e + e * e)
        x, y = x0 + ux * z, y0 + uy * z
        if not w > zero:
            continue
        bow = _smooth(rig.bow, x, y, rig.one)
        x, y = x + ux * bow, y + uy * bow
        seen = phase[first + i] - _smooth(rig.correction, x, y, rig.one)
        if across_known:
            u = (phase_y[first + i] - table_y.along) * table_y.per_rad
            v = (x - table_y.across) * table_y.per_mm
            y = _powers(table_y.place, u, v, rig.one) + bow * _powers(table_y.lift, u, v, rig.one) + table_y.shear * x
        u, v = (seen - table.along) * table.per_rad, (y - table.across) * table.per_mm
        place = _powers(table.place, u, v, rig.one) + bow * _powers(table.lift, u, v, rig.one)
        x = place + table.shear * y
        z = rig.glass_a * x + rig.glass_b * y + rig.glass_c + bow - shift_z
        base_y = rig.camera_y - rig.camera_z * wy
        base = rig.camera_x - rig.camera_z * wx - table.shear * base_y
        across = place - (shift_x - table.shear * shift_y) - base
        up = z - rig.middle
        s0[i] += w
        sz[i] += w * up
        szz[i] += w * up * up
        sx[i] += w * across
        sxz[i] += w * up * across
        sy[i] += w * (y - shift_y - base_y)
        syz[i] += w * up * (y - shift_y - base_y)
        low[i] = min(low[i], z)


@njit(**_SIMD)
def _meet(pixels: Pixels, slopes: Values, table: Table, rig: Rig, sums: Values, first: int, n: int) -> None:
    """Depth from the sums, and the direction of the ray that leaves by the law of reflection."""
    wide_vectors()
    s0, sz, szz, sx, sxz = sums[0], sums[1], sums[2], sums[3], sums[4]
    depth, turned, leave_x, leave_y = sums[7], sums[8], sums[9], sums[10]
    one = rig.one
    for i in range(_u(n)):
        wx, wy, q = pixels.rays_x[first + i], pixels.rays_y[first + i], slopes[i]
        per = one / s0[i]
        middle = sz[i] * per
        spread = szz[i] - sz[i] * middle
        rate = (sxz[i] - sx[i] * middle) / spread
        turn = rate - (wx - table.shear * wy)
        h = (rate * (rig.middle + middle) - sx[i] * per) / turn
        ux = rate + table.shear * leave_y[i]
        # With g, the ratio of the lengths of (ux, uy, 1) and (wx, wy, 1): uy = -wy g - q (1 + g).
        t = wy + q
        a = one + wx * wx + wy * wy - t * t
        g = (q * t + np.sqrt(q * q * t * t + a * (one + ux * ux + q * q))) / a
        leave_x[i] = ux
        leave_y[i] = -wy * g - q * (one + g)
        depth[i] = h
        turned[i] = turn * turn * table.precision


@njit(**_SIMD)
def _meet_across(pixels: Pixels, table: Table, table_y: Table, rig: Rig, sums: Values, first: int, n: int) -> None:
    """As `_meet`, where rows tell the place across: the nearest point of both rays."""
    s0, sz, szz, sx, sxz = sums[0], sums[1], sums[2], sums[3], sums[4]
    depth, turned, leave_x, leave_y, sy, syz = sums[7], sums[8], sums[9], sums[10], sums[11], sums[12]
    for i in range(_u(n)):
        wx, wy = pixels.rays_x[first + i], pixels.rays_y[first + i]
        per = rig.one / s0[i]
        middle = sz[i] * per
        spread = szz[i] - sz[i] * middle
        rate, uy = (sxz[i] - sx[i] * middle) / spread, (syz[i] - sy[i] * middle) / spread
        turn, turn_y = rate - (wx - table.shear * wy), uy - wy
        z = rig.middle + middle
        weight = turn * turn * table.precision + turn_y * turn_y * table_y.precision
        h = turn * (rate * z - sx[i] * per) * table.precision + turn_y * (uy * z - sy[i] * per) * table_y.precision
        h = h / weight
        leave_x[i] = rate + table.shear * uy
        leave_y[i] = uy
        depth[i] = h
        turned[i] = weight


@njit(**_SIMD)
def _put(rig: Rig, sums: Values, results: Results, first: int, n: int) -> None:
    """The depth and, from the line fit's variance at its height, the depth's sigma."""
    wide_vectors()
    s0, sz, szz, low, depth, turned = sums[0], sums[1], sums[2], sums[6], sums[7], sums[8]
    for i in range(_u(n)):
        h = depth[i]
        per = rig.one / s0[i]
        middle = sz[i] * per
        spread = szz[i] - sz[i] * middle
        reach = h - rig.middle - middle
        variance = (per + reach * reach / spread) / turned[i]
        known = (turned[i] > rig.least_turn) & (spread > rig.least_spread * s0[i])
        # No surface lies behind the glass or the camera.
        known = known & (h < low[i]) & (h < rig.camera_z) & (variance < rig.one / (rig.one - rig.one))
        results.depth[first + i] = h if known else rig.nan
        results.sigma[first + i] = np.sqrt(variance) if known else rig.nan


@njit(**_SIMD)
def _put_slopes(pixels: Pixels, rig: Rig, sums: Values, results: Results, first: int, n: int) -> None:
    """Slopes of the surface: its normal halves the angle of the two rays."""
    wide_vectors()
    leave_x, leave_y = sums[9], sums[10]
    one = rig.one
    for i in range(_u(n)):
        wx, wy, ux, uy = pixels.rays_x[first + i], pixels.rays_y[first + i], leave_x[i], leave_y[i]
        g = np.sqrt((one + ux * ux + uy * uy) / (one + wx * wx + wy * wy))
        known = results.depth[first + i] == results.depth[first + i]
        results.slope_x[first + i] = -(ux + wx * g) / (one + g) if known else rig.nan
        results.slope_y[first + i] = -(uy + wy * g) / (one + g) if known else rig.nan


@njit(**_SIMD)
def _clear(sums: Values, one: Any, n: int) -> None:
    wide_vectors()
    for row in (0, 1, 2, 3, 4, 11, 12):
        cleared = sums[row]
        for i in range(_u(n)):
            cleared[i] = one - one
    low = sums[6]
    for i in range(_u(n)):
        low[i] = one / (one - one)


@njit(**_SIMD)
def _round(
    pixels: Pixels, weights: Values, table: Table, table_y: Table, rig: Rig, ways: Ways, sums: Values, number: int,
    first: int, n: int,
) -> None:  # fmt: skip
    """Sums over the views, with the places across that the last round found."""
    _clear(sums, rig.one, n)
    for k in range(pixels.phases.shape[0]):
        phase, weight, shift = pixels.phases[k], weights[k], rig.shifts[k]
        if ways.across or ways.corrected:
            _add_corrected_view(
                phase, pixels.phases_y[k], weight, pixels.rays_x, pixels.rays_y, shift, ways.across, table, table_y,
                rig, sums, first, n,
            )  # fmt: skip
            continue
        _look_up(phase, weight, pixels.rays_x, pixels.rays_y, shift, table, rig, sums, first, n)
        if number == 0:
            _lines(table.place, sums[13], sums[15], n)
        else:
            _polynomials(table.place, sums[13], sums[14], sums[15], n)
        _add_view(weight, pixels.rays_x, pixels.rays_y, shift, table, rig, sums, first, n)


@njit(**_KERNEL)
def triangulate_pixels(
    pixels: Pixels, table: Table, table_y: Table, rig: Rig, ways: Ways, results: Results, first: int, last: int
) -> None:
    """Depth and its sigma for the pixels from ``first`` to ``last``."""
    kind = pixels.rays_x.dtype
    sums, slopes = np.empty((16, BLOCK), kind), np.zeros(BLOCK, kind)
    weights = np.empty((pixels.phases.shape[0], BLOCK), kind)
    for begin in range(first, last, BLOCK):
        n = min(BLOCK, last - begin)
        start = _u(begin)
        for k in range(pixels.phases.shape[0]):
            _weigh(pixels.phases[k], pixels.phases_y[k], pixels.sigmas[k], weights[k], rig.one, start, n)
        if ways.sloped:
            for i in range(n):
                slopes[i] = pixels.slopes[begin + i]
        _start(pixels.rays_y, rig.one, start, sums, n)
        for number in range(ways.rounds):
            _round(pixels, weights, table, table_y, rig, ways, sums, number, start, n)
            if ways.across:
                _meet_across(pixels, table, table_y, rig, sums, start, n)
            else:
                _meet(pixels, slopes, table, rig, sums, start, n)
        _put(rig, sums, results, start, n)
        if results.slope_x.size:
            _put_slopes(pixels, rig, sums, results, start, n)


announce_compilation(triangulate_pixels, "the triangulation kernel")
