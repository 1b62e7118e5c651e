"""Speed of the decoding, beside NumPy and beside the least that the same bytes can cost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from irpmd_rig.bench.timing import Row, faster, median_ms, slower
from irpmd_rig.core.phase import decode
from irpmd_rig.core.phase._wide_vectors import wide_vectors

COUNTS = (64, 63, 56)
STEPS = 4
NUMPY = "numpy float32 arctan2, closed form"
TRIVIAL = "trivial arithmetic, same bytes"

Values = NDArray[Any]
Results = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]


def run(size_px: int = 2048, repeats: int = 15) -> list[Row]:
    """Time ``decode`` on one thread: 3 sets of 4 steps of ``size_px`` x ``size_px``, 8 bits and 10 bits.

    Parameters
    ----------
    size_px
        Side of the square frames.
    repeats
        Rounds; in each, every candidate runs once.

    Returns
    -------
    list of Row
        "decode" (uint8) and "10-bit" (uint16), each against NumPy and against trivial arithmetic, all of them with
        fresh results, and once more with ``out``.
    """
    return [
        *_rows("decode", noisy_frames(size_px, 8), 255, repeats, (20.0, 2.5)),
        *_rows("10-bit", noisy_frames(size_px, 10), 1023, repeats, (18.0, None)),
    ]


def _rows(name: str, frames: Values, saturation_dn: int, repeats: int, aims: tuple[float, float | None]) -> list[Row]:
    reused = f"{name}, maps of an earlier result reused"
    earlier = decode(frames, COUNTS)
    medians = median_ms(
        {
            name: lambda: decode(frames, COUNTS),
            NUMPY: lambda: numpy_decode(frames, saturation_dn),
            TRIVIAL: lambda: trivial(frames),
            reused: lambda: decode(frames, COUNTS, out=earlier),
        },
        repeats,
    )
    return [
        faster(name, medians, NUMPY, 12.0, aims[0]),
        slower(name, medians, TRIVIAL, None, aims[1]),
        faster(reused, medians, NUMPY, None, None),
    ]


def noisy_frames(size_px: int, bits: int) -> Values:
    """Frames (3, 4, size, size) that use half the range, with noise of 1.5 DN (8 bits) from a fixed seed."""
    rng = np.random.default_rng(0)
    scale = 2 ** (bits - 8)
    turns = (np.arange(size_px) + 0.5) / size_px
    frames = np.empty((len(COUNTS), STEPS, size_px, size_px), np.uint8 if bits == 8 else np.uint16)
    noise = rng.normal(0, 1.5, (size_px, size_px)).astype(np.float32)
    for k, count in enumerate(COUNTS):
        for n in range(STEPS):
            fringes = 127 + 100 * np.cos(2 * np.pi * (count * turns + n / STEPS))
            frames[k, n] = np.rint(scale * (fringes.astype(np.float32) + np.roll(noise, 17 * (4 * k + n))))
    return frames


def numpy_decode(frames: Values, saturation_dn: float) -> Results:
    """Return what ``decode`` returns of three sets, the plain NumPy way: whole arrays of float32."""
    c0, c1, c2 = (np.float32(count) for count in COUNTS)
    phases, modulations = [], []
    for first, second, third, fourth in frames:
        sine = np.subtract(fourth, second, dtype=np.float32)
        cosine = np.subtract(first, third, dtype=np.float32)
        phases.append(np.arctan2(sine, cosine) * np.float32(0.5 / np.pi))
        modulations.append(np.float32(0.5) * np.sqrt(sine * sine + cosine * cosine))
    t0, t1, t2 = phases
    coarse = t0 - t1
    coarse -= np.floor(coarse)
    middle = t0 - t2
    guess = (c0 - c2) * coarse - middle
    order = np.rint(guess)
    residual = np.abs(guess - order)
    guess = c0 / (c0 - c2) * (order + middle) - t0
    order = np.rint(guess)
    residual = np.maximum(residual, np.abs(guess - order))
    first_phase = order + t0
    norm = c0 * c0 + c1 * c1 + c2 * c2
    total = c0 * c0 / norm * first_phase
    for count, turns in ((c1, t1), (c2, t2)):
        guess = count / c0 * first_phase - turns
        total += c0 * count / norm * (np.rint(guess) + turns)
    total -= c0 * np.floor(total / c0)
    valid = residual < np.float32(0.375)
    valid &= np.minimum(np.minimum(modulations[0], modulations[1]), modulations[2]) > np.float32(20)
    valid &= frames.max(axis=(0, 1)) < saturation_dn
    phase = np.where(valid, np.float32(2 * np.pi) * total, np.float32(np.nan))
    return phase, (modulations[0] + modulations[1] + modulations[2]) * np.float32(1 / 3), valid


def trivial(frames: Values) -> Results:
    """Return a sum of all frames three times: reads and writes as many bytes as ``decode``."""
    shape = frames.shape[2:]
    results = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.bool_)
    flat = [frame.reshape(-1) for frames_of_set in frames for frame in frames_of_set]
    _sum(*flat, *(result.reshape(-1) for result in results))
    return results


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
def _sum(
    a0: Values, a1: Values, a2: Values, a3: Values, b0: Values, b1: Values, b2: Values, b3: Values,
    c0: Values, c1: Values, c2: Values, c3: Values,
    one: NDArray[np.float32], two: NDArray[np.float32], three: NDArray[np.bool_],
) -> None:  # fmt: skip
    wide_vectors()
    for i in range(one.size):
        total = np.int32(a0[i]) + a1[i] + a2[i] + a3[i] + b0[i] + b1[i] + b2[i] + b3[i]
        value = np.float32(np.int32(total + c0[i] + c1[i] + c2[i] + c3[i]))
        one[i] = value
        two[i] = value + np.float32(1)
        three[i] = value > np.float32(1)
