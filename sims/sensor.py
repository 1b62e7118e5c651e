"""The sensor: electrons to words, and its noise.

The noise is a pure function of (seed, frame number, pixel): a counter is hashed and turned into a pair of
Gaussian numbers (Box and Muller), without a branch, so that it runs in SIMD and does not depend on the number
of threads. Shot noise is taken as Gaussian: at the hundreds to thousands of electrons of a pixel a Poisson
variate differs from it by less than the quantisation.
"""

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from sims.compiled import kernel

_MASK64 = (1 << 64) - 1
_F = np.float32
_U = np.uint32


@intrinsic
def _as_float(_typing: Any, _word: Any) -> Any:
    """Bits of a uint32 as a float32."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.uint32), codegen


@intrinsic
def _as_word(_typing: Any, _number: Any) -> Any:
    """Bits of a float32 as a uint32."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.IntType(32))

    return types.uint32(types.float32), codegen


def frame_key(seed: int, frame: int) -> NDArray[np.uint32]:
    """Three words that make the noise of one frame its own (SplitMix64 of seed and frame number)."""
    state = (seed * 0x9E3779B97F4A7C15 + frame * 0xD1B54A32D192ED03 + 0x632BE59BD9B4E019) & _MASK64
    words = []
    for _ in range(3):
        state = (state + 0x9E3779B97F4A7C15) & _MASK64
        z = state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK64
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK64
        words.append((z ^ (z >> 31)) >> 32)
    return np.array(words, dtype=np.uint32)


@kernel(inline="always")
def _mix(x: int) -> int:
    # A 32-bit bijection with full avalanche (the "lowbias32" constants found by C. Wellons, 2018).
    x = _U(x ^ _U(x >> _U(16)))
    x = _U(x * _U(0x7FEB352D))
    x = _U(x ^ _U(x >> _U(15)))
    x = _U(x * _U(0x846CA68B))
    return _U(x ^ _U(x >> _U(16)))


@kernel(inline="always")
def _minus_two_log(word: int) -> float:
    """-2 ln((word + 1/2) / 2^32), to 1e-6, by exponent and a polynomial for the mantissa's logarithm."""
    x = _F(word) * _F(2.0**-32) + _F(2.0**-33)
    bits = _as_word(x)
    # Mantissa in [sqrt(1/2), sqrt(2)): the logarithm's series is shortest around 1.
    shifted = _U(bits - _U(0x3F3504F3))
    exponent = _F(np.int32(shifted) >> np.int32(23))
    m = _as_float(_U(_U(shifted & _U(0x007FFFFF)) + _U(0x3F3504F3))) - _F(1.0)
    s = m / (m + _F(2.0))
    s2 = s * s
    # ln(1 + m) = 2 artanh(m / (m + 2)).
    log = _F(2.0) * s * (_F(1.0) + s2 * (_F(1 / 3) + s2 * (_F(1 / 5) + s2 * _F(1 / 7))))
    return max(_F(-2.0) * (log + exponent * _F(0.6931471805599453)), _F(0.0))


@kernel(fastmath={"contract"})
def gaussian_row(key: NDArray[np.uint32], row: int, out: NDArray[np.float32]) -> None:
    """Fill one row (of even length) with unit Gaussian numbers."""
    half = out.size // 2
    first, second = out[:half], out[half:]
    k0, k1, k2 = key[0], key[1], key[2]
    start = _U(row * half)
    for j in range(half):
        counter = _mix(_U(_U(start + _U(j)) + k0))
        radius = np.sqrt(_minus_two_log(_mix(_U(counter ^ k1))))
        turn = _mix(_U(counter + k2))
        # Two bits choose the quadrant, the others an angle in [-pi/4, pi/4).
        angle = _F(np.int32(turn << _U(2))) * _F(math.pi / 4 * 2.0**-31)
        a2 = angle * angle
        sine = angle * (_F(1.0) + a2 * (_F(-1 / 6) + a2 * (_F(1 / 120) + a2 * _F(-1 / 5040))))
        cosine = _F(1.0) + a2 * (_F(-0.5) + a2 * (_F(1 / 24) + a2 * (_F(-1 / 720) + a2 * _F(1 / 40320))))
        swap = _U(turn >> _U(31)) != _U(0)
        flip = _U(_U(turn >> _U(30)) & _U(1)) << _U(31)
        a = sine if swap else cosine
        b = cosine if swap else -sine
        first[j] = radius * _as_float(_U(_as_word(a) ^ _U(flip)))
        second[j] = radius * _as_float(_U(_as_word(b) ^ _U(flip)))


@kernel(fastmath={"contract"})
def words_row(
    electrons: NDArray[np.float32],
    noise: NDArray[np.float32],
    shot: np.float32,
    read2: np.float32,
    full_well: np.float32,
    per_electron: np.float32,
    full_scale: np.float32,
    inverse_gamma: np.float32,
    out: NDArray[np.uint16],
) -> None:
    """Turn electrons into words: noise of variance shot * electrons + read2, clipped at well and scale."""
    if inverse_gamma == _F(1.0):
        for j in range(out.size):
            e = electrons[j]
            e = min(e + noise[j] * np.sqrt(shot * e + read2), full_well) * per_electron
            out[j] = np.int32(min(max(e, _F(0.0)), full_scale) + _F(0.5))
    else:
        for j in range(out.size):
            e = electrons[j]
            e = min(e + noise[j] * np.sqrt(shot * e + read2), full_well) * per_electron
            share = min(max(e / full_scale, _F(0.0)), _F(1.0))
            out[j] = np.int32(full_scale * share**inverse_gamma + _F(0.5))
