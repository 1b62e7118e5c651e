"""The compiled kernel of the triangulation from two views, x fringes alone and a plane glass: the common case.

It does what `irpmd_rig.core.reconstruction._triangulation_kernel` does: a line through two points needs no sums, and
all of a pixel stays in registers.
"""

from __future__ import annotations

from typing import Any

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
    Table,
    Values,
    cubic,
    lit,
    polynomial,
    surface_slope,
    terms,
)

_u = np.uintp
_DEPTH, _SIGMA, _UX, _UY, _SLOPE = (_u(PITCH * k) for k in range(5))
_SLOTS = 5


@njit(forceinline=True, **SIMD)
def _point(rig: Rig, table: Table, shift: Any, place: Any, y: Any, seen: Any) -> Any:
    """A lit point beside the camera, across the fringes, and its height."""
    z = rig.glass_a * (place + table.shear * y) + rig.glass_b * y + rig.glass_c - shift[2]
    moved = shift[0] - table.shear * shift[1] + rig.camera_x - table.shear * rig.camera_y
    return place - moved + rig.camera_z * (seen[0] - table.shear * seen[1]), z


@njit(forceinline=True, **SIMD)
def _reflected(rig: Rig, table: Table, points: Any, uy: Any, seen: Any, q: Any) -> Any:
    """Depth, the ray that leaves, and one over the rise of the line through both points and its turn to the ray."""
    (x1, z1), (x2, z2) = points
    wx, wy = seen
    one = rig.one
    per_rise = one / (z2 - z1)
    rate = (x2 - x1) * per_rise
    turn = rate - (wx - table.shear * wy)
    ux = rate + table.shear * uy
    # With g, the ratio of the lengths of (ux, uy, 1) and (wx, wy, 1): uy = -wy g - q (1 + g).
    t = wy + q
    a = one + wx * wx + wy * wy - t * t
    # One division for two.
    both = one / (a * turn)
    g = (q * t + np.sqrt(q * q * t * t + a * (one + ux * ux + q * q))) * (both * turn)
    h = (rate * z1 - x1) * (both * a)
    return h, (ux, -wy * g - q * (one + g)), per_rise, both * a


@njit(forceinline=True, **SIMD)
def _again(of_degree: Any, c: Any, given: Any, found: Any, rig: Rig, table: Table) -> Any:
    """Depth and the ray that leaves, from the places across that an earlier depth and ray tell."""
    (phase1, phase2), seen, q = given
    h, leaving = found
    m = rig.shifts
    shift1, shift2 = (m[0, 0], m[0, 1], m[0, 2]), (m[1, 0], m[1, 1], m[1, 2])
    _, y1 = lit(rig, shift1, h, leaving, seen)
    _, y2 = lit(rig, shift2, h, leaving, seen)
    place1 = of_degree(c, (phase1 - table.along) * table.per_rad, (y1 - table.across) * table.per_mm)
    place2 = of_degree(c, (phase2 - table.along) * table.per_rad, (y2 - table.across) * table.per_mm)
    points = _point(rig, table, shift1, place1, y1, seen), _point(rig, table, shift2, place2, y2, seen)
    return _reflected(rig, table, points, leaving[1], seen, q), (points[0][1], points[1][1])


@njit(**SIMD)
def _begin(phases: Any, pixels: Pixels, table: Table, rig: Rig, s: Values, first: int, n: int) -> None:
    """Depth and ray by the light that a mirror at height zero would reflect."""
    wide_vectors()
    phase1, phase2 = phases
    few = table.coarse
    c = (few[0, 0], few[0, 1], few[0, 2], few[0, 3], few[1, 0], few[1, 1], few[1, 2], few[2, 0], few[2, 1], few[3, 0])
    zero = rig.one - rig.one
    for i in range(_u(n)):
        seen, q = (pixels.rays_x[first + i], pixels.rays_y[first + i]), s[_SLOPE + i]
        given = (phase1[first + i], phase2[first + i]), seen, q
        found, _ = _again(cubic, c, given, (zero, (-seen[0], -seen[1] - q - q)), rig, table)
        s[_DEPTH + i] = found[0]
        s[_UX + i], s[_UY + i] = found[1]


@njit(**SIMD)
def _improve(
    phases: Any, sigmas: Any, pixels: Pixels, table: Table, rig: Rig, s: Values, first: int, n: int
) -> None:  # fmt: skip
    """Depth, ray and sigma by the light that they tell themselves."""
    wide_vectors()
    c = terms(table.place)
    (phase1, phase2), (sigma1, sigma2) = phases, sigmas
    zero = rig.one - rig.one
    for i in range(_u(n)):
        seen, q = (pixels.rays_x[first + i], pixels.rays_y[first + i]), s[_SLOPE + i]
        given = (phase1[first + i], phase2[first + i]), seen, q
        before = s[_DEPTH + i], (s[_UX + i], s[_UY + i])
        (h, leaving, per_rise, per_turn), (z1, z2) = _again(polynomial, c, given, before, rig, table)
        v1, v2 = sigma1[first + i] * sigma1[first + i], sigma2[first + i] * sigma2[first + i]
        per = per_rise * per_turn
        variance = ((z2 - h) * (z2 - h) * v1 + (h - z1) * (h - z1) * v2) * (per * per) * table.mm2_per_rad2
        known = (per_turn * per_turn * rig.least_turn < table.precision) & (variance < rig.one / zero)
        known = known & (rig.least_spread * (v1 + v2) * (v1 + v2) * per_rise * per_rise < v1 * v2)
        # No surface lies behind the glass or the camera.
        known = known & (h < min(z1, z2)) & (h < rig.camera_z)
        s[_DEPTH + i] = h
        s[_UX + i], s[_UY + i] = leaving
        s[_SIGMA + i] = np.sqrt(variance) if known else rig.nan


@njit(**SIMD)
def _slopes(pixels: Pixels, s: Values, zero: Any, first: int, n: int) -> None:
    wide_vectors()
    if pixels.slopes.size:
        for i in range(_u(n)):
            s[_SLOPE + i] = pixels.slopes[first + i]
    else:
        for i in range(_u(n)):
            s[_SLOPE + i] = zero


@njit(**SIMD)
def _put(rig: Rig, s: Values, results: Results, first: int, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        results.sigma[first + i] = s[_SIGMA + i]
    for i in range(_u(n)):
        results.depth[first + i] = s[_DEPTH + i] if s[_SIGMA + i] >= rig.one - rig.one else rig.nan


@njit(**SIMD)
def _put_slopes(pixels: Pixels, rig: Rig, s: Values, results: Results, first: int, n: int) -> None:
    wide_vectors()
    for i in range(_u(n)):
        known = s[_SIGMA + i] >= rig.one - rig.one
        x, y = surface_slope(rig.one, (pixels.rays_x[first + i], pixels.rays_y[first + i]), (s[_UX + i], s[_UY + i]))
        results.slope_x[first + i] = x if known else rig.nan
        results.slope_y[first + i] = y if known else rig.nan


@njit(**KERNEL)
def triangulate_two_views(pixels: Pixels, table: Table, rig: Rig, rounds: int, results: Results) -> None:
    """Depth and its sigma for all pixels."""
    size = pixels.rays_x.size
    s = np.empty(_SLOTS * PITCH, pixels.rays_x.dtype)
    phases, sigmas = (pixels.phases[0], pixels.phases[1]), (pixels.sigmas[0], pixels.sigmas[1])
    for begin in range(0, size, BLOCK):
        n = min(BLOCK, size - begin)
        first = _u(begin)
        _slopes(pixels, s, rig.one - rig.one, first, n)
        _begin(phases, pixels, table, rig, s, first, n)
        for _ in range(rounds - 1):
            _improve(phases, sigmas, pixels, table, rig, s, first, n)
        _put(rig, s, results, first, n)
        if results.slope_x.size:
            _put_slopes(pixels, rig, s, results, first, n)


announce_compilation(triangulate_two_views, "the triangulation kernel of two views")
