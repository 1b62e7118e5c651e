"""The compiled kernels of the decoding: SIMD loops over blocks of pixels, without the interpreter's lock.

What keeps LLVM vectorising the inner loops (physics notes, section 8): 1-D arrays only, unsigned indices (no
wrap-around test), no branch that depends on data, no call that is not inlined (``rint`` is the addition of
1.5 x 2^23), no exceptions (``error_model="numpy"``). Short loops over a block in the cache beat one long
loop: their chains of dependent operations are shorter than what the processor can look ahead. Neither
reassociation nor the assumption that there are no NaN is allowed: the rounding and the invalid pixels
need both.

All of it is one file because Numba's cache looks only at the file of the function that is called: a change of
an inner loop in another file would go unnoticed.

Phases are in turns, -0.5..0.5, within this module.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload
from numpy.typing import NDArray

from irpmd_rig.core._kernel_notice import announce_compilation
from irpmd_rig.core.phase._wide_vectors import wide_vectors

Values = NDArray[Any]
Floats = NDArray[np.float32]

BLOCK = 8192
"""Pixels of a block: its frames, phases and modulations stay in the second-level cache."""

_SIMD = {"fastmath": {"contract", "nsz"}, "error_model": "numpy", "nogil": True}
_KERNEL = {"cache": True, "error_model": "numpy", "nogil": True}
_f = np.float32
_u = np.uintp

# Minimax polynomials on 0..1 (Remez): arctan(q) / (2 pi) = q P(q^2), error below 1.7e-6 rad;
# sqrt(1 + q^2) = Q(q^2), error below 8.4e-6 of the value.
_P0, _P1, _P2, _P3, _P4, _P5 = (
    _f(c / (2 * np.pi))
    for c in (
        0.9999772190800204,
        -0.3326228278423419,
        0.193540375780673,
        -0.11642648120076067,
        0.05264735063101805,
        -0.011719135411226255,
    )
)
_Q0, _Q1, _Q2, _Q3, _Q4 = (
    _f(c)
    for c in (
        1.000008361037281,
        0.4994969529648263,
        -0.12019418819928857,
        0.045627000059929694,
        -0.010736387781971326,
    )
)
_ZERO, _QUARTER, _HALF, _ONE = _f(0), _f(0.25), _f(0.5), _f(1)
_ROUND = _f(12582912)
_TINY = _f(1e-30)
_NAN = _f(np.nan)
# 2 pi as a float32 with a short mantissa, exact times any order up to 4096, and the rest of it.
_TAU_HIGH = _f(6.28125)
_TAU_LOW = _f(2 * np.pi - 6.28125)
_ROOT_HALF = _f(np.sqrt(0.5))
_THIRD = _f(1 / 3)


class Rungs(NamedTuple):
    """The ladder of `irpmd_rig.core.phase.counts.Ladder`, as the kernel takes it."""

    sets: NDArray[np.int64]
    beats: bool
    lowest: np.float32
    ratios: Floats
    corrections: Floats


class Gates(NamedTuple):
    """What decides whether a pixel is valid, and where its phase is folded; float32 scalars, phases in turns.

    ``brightest``, of the frames' own type, is the largest value that is not saturated.
    """

    modulation: np.float32
    residual: np.float32
    brightest: Any
    low: np.float32
    high: np.float32
    period: np.float32


class Maps(NamedTuple):
    """Flat results of a run of pixels."""

    phase_rad: Floats
    modulation: Floats
    valid: NDArray[np.bool_]


def _minus(a: Any, b: Any) -> Any:
    """Subtract two values of frames as float32; compiled only."""


@overload(_minus, jit_options=_SIMD)
def _typed_minus(a: Any, b: Any) -> Any:  # noqa: ARG001 - the types of a and b
    def whole(a: Any, b: Any) -> Any:
        # One conversion to float32 instead of two.
        return np.float32(np.int32(np.int32(a) - np.int32(b)))

    def real(a: Any, b: Any) -> Any:
        return a - b

    return whole if isinstance(a, types.Integer) else real


@njit(**_SIMD)
def _turns(low: np.float32, high: np.float32, q: np.float32, s: np.float32, c: np.float32) -> np.float32:
    y = q * q
    yy = y * y
    turns = q * ((_P0 + y * _P1) + yy * ((_P2 + y * _P3) + yy * (_P4 + y * _P5)))
    turns = _QUARTER - turns if low > high else turns
    turns = _HALF - turns if c < _ZERO else turns
    return -turns if s < _ZERO else turns


@njit(**_SIMD)
def _polar(s: np.float32, c: np.float32, scale: np.float32) -> tuple[np.float32, np.float32]:
    size_s = abs(s)
    size_c = abs(c)
    large = max(size_s, size_c)
    q = min(size_s, size_c) / max(large, _TINY)
    y = q * q
    yy = y * y
    modulation = large * scale * ((_Q0 + y * _Q1) + yy * ((_Q2 + y * _Q3) + yy * _Q4))
    return _turns(size_s, size_c, q, s, c), modulation


@njit(**_SIMD)
def _four_steps(
    frames: Values,
    first: int,
    pixels: int,
    turns: Floats,
    modulation: Floats,
    peak: Values,
    n: int,
) -> None:
    """Phase, modulation and brightest value of a set of four steps."""
    wide_vectors()
    i1, i2, i3 = first + pixels, first + _u(2) * pixels, first + _u(3) * pixels
    for i in range(_u(n)):
        v0, v1, v2, v3 = frames[first + i], frames[i1 + i], frames[i2 + i], frames[i3 + i]
        turns[i], modulation[i] = _polar(_minus(v3, v1), _minus(v0, v2), _HALF)
        peak[i] = max(peak[i], max(max(v0, v1), max(v2, v3)))


@njit(**_SIMD)
def _eight_steps(
    frames: Values,
    first: int,
    pixels: int,
    turns: Floats,
    modulation: Floats,
    peak: Values,
    n: int,
) -> None:
    """Phase, modulation and brightest value of a set of eight steps."""
    wide_vectors()
    i1, i2, i3 = first + pixels, first + _u(2) * pixels, first + _u(3) * pixels
    i4 = first + _u(4) * pixels
    i5, i6, i7 = i4 + pixels, i4 + _u(2) * pixels, i4 + _u(3) * pixels
    for i in range(_u(n)):
        v0, v1, v2, v3 = frames[first + i], frames[i1 + i], frames[i2 + i], frames[i3 + i]
        v4, v5, v6, v7 = frames[i4 + i], frames[i5 + i], frames[i6 + i], frames[i7 + i]
        d1 = _minus(v1, v5)
        d3 = _minus(v3, v7)
        s = _minus(v6, v2) - _ROOT_HALF * (d1 + d3)
        c = _minus(v0, v4) + _ROOT_HALF * (d1 - d3)
        turns[i], modulation[i] = _polar(s, c, _QUARTER)
        top = max(max(max(v0, v1), max(v2, v3)), max(max(v4, v5), max(v6, v7)))
        peak[i] = max(peak[i], top)


@njit(**_SIMD)
def _add_step(
    frames: Values,
    first: int,
    sine: np.float32,
    cosine: np.float32,
    s: Floats,
    c: Floats,
    peak: Values,
    n: int,
) -> None:
    """One step of a set of any number of steps, into the sums ``s`` and ``c``."""
    wide_vectors()
    for i in range(_u(n)):
        v = frames[first + i]
        s[i] -= sine * _f(v)
        c[i] += cosine * _f(v)
        peak[i] = max(peak[i], v)


@njit(**_SIMD)
def _to_polar(s: Floats, c: Floats, scale: np.float32, n: int) -> None:
    """Turn sums into phase (in place of ``s``) and modulation (in place of ``c``)."""
    wide_vectors()
    for i in range(_u(n)):
        s[i], c[i] = _polar(s[i], c[i], scale)


@njit(**_SIMD)
def _finished(order: np.float32, rest: np.float32, gates: Gates) -> np.float32:
    # From above first: what rounds up to a whole period may lie just below it.
    order = order - gates.period if order + rest >= gates.high else order
    order = order + gates.period if order + rest < gates.low else order
    return order * _TAU_HIGH + (order * _TAU_LOW + rest * (_TAU_HIGH + _TAU_LOW))


@njit(**_SIMD)
def _climb_three_beats(
    turns: Floats, strength: Floats, peak: Values, rungs: Rungs, gates: Gates, maps: Maps, o: int, n: int
) -> None:
    """Climb the whole ladder of three sets by the optimum method: the usual case, fused."""
    wide_vectors()
    t1, t2, t3 = turns[0], turns[1], turns[2]
    m1, m2, m3 = strength[0], strength[1], strength[2]
    r1, r2, w1, w2 = rungs.ratios[0], rungs.ratios[1], rungs.corrections[0], rungs.corrections[1]
    phase, modulation, valid = maps
    for i in range(_u(n)):
        beat = t3[i] - t1[i]
        absolute = beat + _ONE if beat < _ZERO else beat
        beat = t3[i] - t2[i]
        guess = r1 * absolute - beat
        order = (guess + _ROUND) - _ROUND
        residual1 = guess - order
        guess = r2 * (order + beat) - t3[i]
        order = (guess + _ROUND) - _ROUND
        residual2 = guess - order
        radians = _finished(order, t3[i] - w1 * residual1 - w2 * residual2, gates)
        weakest = min(min(m1[i], m2[i]), m3[i])
        worst = max(abs(residual1), abs(residual2))
        good = (weakest >= gates.modulation) & (worst <= gates.residual) & (peak[i] <= gates.brightest)
        phase[o + i] = radians if good else _NAN
        modulation[o + i] = (m1[i] + m2[i] + m3[i]) * _THIRD
        valid[o + i] = good


@njit(**_SIMD)
def _to_beat(finest: Floats, turns: Floats, n: int) -> None:
    """Phase of the beat of a set with the finest, in place of the set's own."""
    wide_vectors()
    for i in range(_u(n)):
        turns[i] = finest[i] - turns[i]


@njit(**_SIMD)
def _first_rung(
    turns: Floats,
    modulation: Floats,
    lowest: np.float32,
    absolute: Floats,
    worst: Floats,
    rest: Floats,
    weakest: Floats,
    n: int,
) -> None:
    """Start of a ladder: the coarsest phase, cut at ``lowest`` turns."""
    wide_vectors()
    for i in range(_u(n)):
        absolute[i] = turns[i] + _ONE if turns[i] < lowest else turns[i]
        worst[i] = _ZERO
        rest[i] = _ZERO
        weakest[i] = modulation[i]


@njit(**_SIMD)
def _next_rung(
    turns: Floats,
    ratio: np.float32,
    weight: np.float32,
    absolute: Floats,
    worst: Floats,
    rest: Floats,
    n: int,
) -> None:
    """One rung: the order of ``turns`` from the absolute phase below it."""
    wide_vectors()
    for i in range(_u(n)):
        guess = ratio * absolute[i] - turns[i]
        order = (guess + _ROUND) - _ROUND
        residual = guess - order
        absolute[i] = order + turns[i]
        worst[i] = max(worst[i], abs(residual))
        rest[i] -= weight * residual


@njit(**_SIMD)
def _gather(total: Floats, weakest: Floats, modulation: Floats, n: int) -> None:
    """Sum and least of the sets' modulations."""
    wide_vectors()
    for i in range(_u(n)):
        total[i] += modulation[i]
        weakest[i] = min(weakest[i], modulation[i])


@njit(**_SIMD)
def _last_rung(
    turns: Floats,
    absolute: Floats,
    worst: Floats,
    rest: Floats,
    total: Floats,
    weakest: Floats,
    peak: Values,
    part: np.float32,
    gates: Gates,
    maps: Maps,
    o: int,
    n: int,
) -> None:
    """Top of a ladder: gates, folding, radians."""
    wide_vectors()
    phase, modulation, valid = maps
    for i in range(_u(n)):
        order = ((absolute[i] - turns[i]) + _ROUND) - _ROUND
        radians = _finished(order, turns[i] + rest[i], gates)
        good = (weakest[i] >= gates.modulation) & (worst[i] <= gates.residual) & (peak[i] <= gates.brightest)
        phase[o + i] = radians if good else _NAN
        modulation[o + i] = total[i] * part
        valid[o + i] = good


@njit(**_SIMD)
def _largest(values: Values, n: int) -> Any:
    """Largest of the first n values."""
    wide_vectors()
    top = values[0]
    for i in range(_u(n)):
        top = max(top, values[i])
    return top


@njit(nogil=True, error_model="numpy")
def _set_block(
    frames: Values,
    first: int,
    pixels: int,
    sines: Floats,
    cosines: Floats,
    turns: Floats,
    strength: Floats,
    peak: Values,
    n: int,
) -> None:
    wide_vectors()
    if sines.size == 4:
        _four_steps(frames, first, pixels, turns, strength, peak, n)
    elif sines.size == 8:
        _eight_steps(frames, first, pixels, turns, strength, peak, n)
    else:
        turns[:n] = 0
        strength[:n] = 0
        for step in range(sines.size):
            o = first + _u(step) * pixels
            _add_step(frames, o, sines[step], cosines[step], turns, strength, peak, n)
        _to_polar(turns, strength, _f(2.0 / sines.size), n)


@njit(nogil=True, error_model="numpy")
def _climb(
    turns: Floats,
    strength: Floats,
    scratch: Floats,
    peak: Values,
    rungs: Rungs,
    gates: Gates,
    maps: Maps,
    o: int,
    n: int,
) -> None:
    wide_vectors()
    absolute, worst, rest, weakest = scratch[0], scratch[1], scratch[2], scratch[3]
    finest = rungs.sets.size - 1
    if rungs.beats:
        for j in range(finest):
            _to_beat(turns[finest], turns[j], n)
    _first_rung(turns[0], strength[0], rungs.lowest, absolute, worst, rest, weakest, n)
    for j in range(1, finest + 1):
        _next_rung(turns[j], rungs.ratios[j - 1], rungs.corrections[j - 1], absolute, worst, rest, n)
        _gather(strength[0], weakest, strength[j], n)
    part = _f(1.0 / (finest + 1))
    _last_rung(turns[finest], absolute, worst, rest, strength[0], weakest, peak, part, gates, maps, o, n)


@njit(**_KERNEL)
def decode_pixels(
    frames: Values, sines: Floats, cosines: Floats, rungs: Rungs, gates: Gates, maps: Maps, first: int
) -> Any:
    """Decode as many pixels of flat (sets * steps * pixels) frames as the maps hold, from ``first`` on.

    Returns the largest value met. Blocks start at ``first``: to be independent of how the work is shared,
    ``first`` must be a multiple of BLOCK.
    """
    wide_vectors()
    sets, steps = rungs.sets.size, sines.size
    pixels = frames.size // (sets * steps)
    count = maps.valid.size
    size = min(BLOCK, count)
    turns = np.empty((sets, size), np.float32)
    strength = np.empty((sets, size), np.float32)
    scratch = np.empty((4, size), np.float32)
    peak = np.empty(size, frames.dtype)
    top = peak.dtype.type(0)
    for start in range(0, count, BLOCK):
        n = min(count - start, BLOCK)
        peak[:n] = 0
        for j in range(sets):
            o = _u(rungs.sets[j] * steps * pixels + first + start)
            _set_block(frames, o, _u(pixels), sines, cosines, turns[j], strength[j], peak, n)
        top = max(top, _largest(peak, n))
        if rungs.beats and sets == 3:
            _climb_three_beats(turns, strength, peak, rungs, gates, maps, _u(start), n)
        else:
            _climb(turns, strength, scratch, peak, rungs, gates, maps, _u(start), n)
    return top


@njit(**_SIMD)
def _wrapped(
    turns: Floats, strength: Floats, least: np.float32, phase: Floats, modulation: Floats, o: int, n: int
) -> None:
    wide_vectors()
    for i in range(_u(n)):
        phase[o + i] = turns[i] * (_TAU_HIGH + _TAU_LOW) if strength[i] >= least else _NAN
        modulation[o + i] = strength[i]


@njit(**_KERNEL)
def wrap_pixels(
    frames: Values, sines: Floats, cosines: Floats, least: np.float32, phase: Floats, modulation: Floats
) -> None:
    """Put the wrapped phases of flat (sets * steps * pixels) frames into (sets, pixels) maps."""
    wide_vectors()
    sets, pixels = phase.shape
    size = min(BLOCK, pixels)
    turns = np.empty(size, np.float32)
    strength = np.empty(size, np.float32)
    peak = np.empty(size, frames.dtype)
    for j in range(sets):
        for start in range(0, pixels, BLOCK):
            n = min(pixels - start, BLOCK)
            first = j * sines.size * pixels + start
            peak[:n] = 0
            _set_block(frames, _u(first), _u(pixels), sines, cosines, turns, strength, peak, n)
            _wrapped(turns, strength, least, phase[j], modulation[j], _u(start), n)


@njit(**_SIMD, cache=True)
def largest_bits(bits: NDArray[np.uint32]) -> np.uint32:
    """Return the largest float32 without its sign, given and returned as bits; NaN count as largest."""
    wide_vectors()
    top = np.uint32(0)
    for i in range(_u(bits.size)):
        top = max(top, np.uint32(bits[i] & np.uint32(0x7FFFFFFF)))
    return top


announce_compilation(decode_pixels, "the decoding kernel")
announce_compilation(wrap_pixels, "the kernel of the wrapped phases")
