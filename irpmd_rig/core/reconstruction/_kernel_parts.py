"""What the kernels of the triangulation share: their arguments, and the functions of one pixel that they inline.

Numba's cache looks only at the file of the function that is called: after a change here the kernels are to be changed,
too, or their caches deleted.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Values = NDArray[Any]

BLOCK = 512
"""Pixels of a block: what its loops hand on stays in the core's own cache."""

PITCH = BLOCK + 48
"""From slot to slot of what they hand on: a power of two apart, slots would share few lines of the cache, and loads
would wait for stores to other slots."""

SIMD = {"fastmath": {"contract", "nsz"}, "error_model": "numpy", "nogil": True}
KERNEL = {"cache": True, "error_model": "numpy", "nogil": True}


class Table(NamedTuple):
    """`irpmd_rig.core.reconstruction.glass_map.GlassMap`, scaled for the kernel; scalars and arrays of one type."""

    along: Any
    per_rad: Any
    across: Any
    per_mm: Any
    shear: Any
    coarse: Values
    place: Values
    lift: Values
    mm2_per_rad2: Any
    precision: Any
    """1 / mm2_per_rad2: weight of a measured place."""


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
    """Assumed dz/dy of the surface; empty: level."""


class Results(NamedTuple):
    """Flat results; the slopes may be empty."""

    depth: Values
    sigma: Values
    slope_x: Values
    slope_y: Values


@njit(forceinline=True, **SIMD)
def terms(c: Values) -> Any:
    """Coefficients of degree 7 as so many scalars, which LLVM keeps out of the loop."""
    return (
        c[0, 0], c[0, 1], c[0, 2], c[0, 3], c[0, 4], c[0, 5], c[0, 6], c[0, 7],
        c[1, 0], c[1, 1], c[1, 2], c[1, 3], c[1, 4], c[1, 5], c[1, 6],
        c[2, 0], c[2, 1], c[2, 2], c[2, 3], c[2, 4], c[2, 5],
        c[3, 0], c[3, 1], c[3, 2], c[3, 3], c[3, 4],
        c[4, 0], c[4, 1], c[4, 2], c[4, 3],
        c[5, 0], c[5, 1], c[5, 2],
        c[6, 0], c[6, 1],
        c[7, 0],
    )  # fmt: skip


@njit(forceinline=True, **SIMD)
def polynomial(c: Any, u: Any, v: Any) -> Any:
    total = c[35]
    total = total * v + (c[34] * u + c[33])
    total = total * v + ((c[32] * u + c[31]) * u + c[30])
    total = total * v + (((c[29] * u + c[28]) * u + c[27]) * u + c[26])
    total = total * v + ((((c[25] * u + c[24]) * u + c[23]) * u + c[22]) * u + c[21])
    total = total * v + (((((c[20] * u + c[19]) * u + c[18]) * u + c[17]) * u + c[16]) * u + c[15])
    total = total * v + ((((((c[14] * u + c[13]) * u + c[12]) * u + c[11]) * u + c[10]) * u + c[9]) * u + c[8])
    return total * v + (((((((c[7] * u + c[6]) * u + c[5]) * u + c[4]) * u + c[3]) * u + c[2]) * u + c[1]) * u + c[0])


@njit(forceinline=True, **SIMD)
def cubic(c: Any, u: Any, v: Any) -> Any:
    total = c[9]
    total = total * v + (c[8] * u + c[7])
    total = total * v + ((c[6] * u + c[5]) * u + c[4])
    return total * v + (((c[3] * u + c[2]) * u + c[1]) * u + c[0])


@njit(forceinline=True, **SIMD)
def lit(rig: Rig, shift: Any, h: Any, leaving: Any, seen: Any) -> Any:
    """Where the ray that leaves the surface meets the plane of the glass."""
    ux, uy = leaving
    x = rig.camera_x + (h - rig.camera_z) * seen[0] - ux * h + shift[0]
    y = rig.camera_y + (h - rig.camera_z) * seen[1] - uy * h + shift[1]
    e = rig.glass_a * ux + rig.glass_b * uy
    # 1 / (1 - e), e being the glass's tilt: far more than what the place across needs.
    z = (rig.glass_a * x + rig.glass_b * y + rig.glass_c - shift[2]) * (rig.one + e + e * e)
    return x + ux * z, y + uy * z


@njit(forceinline=True, **SIMD)
def surface_slope(one: Any, seen: Any, leaving: Any) -> Any:
    """Slopes of the surface: its normal halves the angle of the two rays."""
    (wx, wy), (ux, uy) = seen, leaving
    g = np.sqrt((one + ux * ux + uy * uy) / (one + wx * wx + wy * wy))
    return -(ux + wx * g) / (one + g), -(uy + wy * g) / (one + g)
