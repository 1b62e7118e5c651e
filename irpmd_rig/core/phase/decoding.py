"""From fringe frames to absolute phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.arguments import checked_number, is_integer
from irpmd_rig.core.errors import FramesError, MeasurementError
from irpmd_rig.core.phase._kernels import BLOCK, Gates, Maps, Rungs, decode_pixels, wrap_pixels
from irpmd_rig.core.phase.counts import RESIDUAL_MARGIN_TURNS, Ladder, checked_counts, ladder
from irpmd_rig.core.phase.frames import Frames, Values, checked_frames, chunk_count, chunks
from irpmd_rig.core.phase.noise import estimate_noise, sample_cells
from irpmd_rig.core.phase.response import CameraResponse
from irpmd_rig.core.phase.results import AbsolutePhase, NoiseModel, WrappedPhases, thinning
from irpmd_rig.core.threads import over_rows

_f = np.float32
Floats = npt.NDArray[np.float32]


def decode(
    frames: npt.ArrayLike,
    counts: Sequence[float],
    *,
    unwrapping: Literal["optimum", "hierarchical"] = "optimum",
    threads: int = 1,
    response: CameraResponse | None = None,
    saturation_dn: float | None = None,
    min_modulation_dn: float | None = None,
    out: AbsolutePhase | None = None,
) -> AbsolutePhase:
    """Absolute phase of the finest fringe set at every pixel.

    Parameters
    ----------
    frames
        (sets, steps, H, W) uint8, uint16 or float32; at least 3 steps, step n shifted by ``+2 pi n / steps``.
        Any memory layout; C-contiguous is fastest.
    counts
        Fringe count (periods across the projector) of each set, in any order.
    unwrapping
        ``"optimum"``: the beats of the finest set with the others, which must be whole numbers that start at
        1 (64, 63, 56: 1, 8, 64); the orders are folded, so that both ends of the projector are right, and
        the phase is the noise-weighted mean of all sets, in 0..2 pi count. ``"hierarchical"``: from coarse to
        fine, any real counts of which the coarsest is at most 1; the phase is that of the finest set
        alone (the coarser ones would add little, and their harmonics).
    threads
        Threads that share the pixels; the result does not depend on it.
    response
        Camera response that is applied first. Modulations and noise are then in its linear units.
    saturation_dn
        A pixel with a step at or above this is not valid. Default 255 (uint8), 1023 (uint16: 10 bits), none
        (float32); always in the units of ``frames``.
    min_modulation_dn
        Least modulation B of every set. Default: 14 sigma_I(B), sigma_I from the noise of the frames
        themselves, and more for ladders so steep that 14 would let wrong orders pass.
    out
        An earlier result of the same size that is no longer needed: its arrays are overwritten and returned
        in the new one. Fresh memory costs about as much as half of the decoding.

    Raises
    ------
    FramesError
        Wrong shape or type, too few steps, values that are masked, not finite or above the full scale.
    CountsError
        Counts that the method cannot use.
    MeasurementError
        An unknown ``unwrapping``, an impossible number of threads or threshold, a ``response`` of another type,
        an ``out`` whose arrays cannot be overwritten: another size, type or layout, or read-only.

    Notes
    -----
    The paper, eqs. (2) to (4); physics notes, sections 3 and 8. A pixel is valid only if every rung of the
    ladder rounds by less than 0.375 turns (`irpmd_rig.core.phase.counts`). The noise-weighted mean
    of 64, 63 and 56 fringes is 1.65 times better than the 64 alone. Of 64 fringes phases are
    computed to a few 1e-6 rad and then rounded to float32 (1.5e-5 rad); at worst, hundreds of fringes in many
    sets, they are wrong by 1.5 units in the last place of float32.
    """
    taken = checked_frames(frames, response, saturation_dn)
    sets, steps, height, width = taken.values.shape
    periods = checked_counts(counts, sets)
    rungs = ladder(periods, unwrapping)
    if not is_integer(threads) or threads < 1:
        raise MeasurementError(f"threads must be a whole number of at least 1, got {threads!r}")
    chosen = None if min_modulation_dn is None else checked_number("min_modulation_dn", min_modulation_dn)
    maps = _maps(height, width, out)
    noise = _noise(taken, rungs)
    gate = noise.least_modulation_dn(rungs.gate(steps)) if chosen is None else chosen
    least = max(gate, taken.rounding_dn)
    settings = _settings(taken, rungs, least)
    flat = taken.direct
    largest = (
        _decode_in_place(flat, settings, maps, threads)
        if flat is not None
        else _decode_copies(taken, settings, maps, threads)
    )
    if largest > taken.full_scale_dn:
        raise FramesError(
            f"a value of {largest:g} is above {taken.full_scale_dn:g}, the full scale assumed for "
            f"{taken.values.dtype} frames (10 bits): pass saturation_dn, for example 4095 for 12 bits"
        )
    return AbsolutePhase(
        phase_rad=maps.phase_rad.reshape(height, width),
        modulation_dn=maps.modulation.reshape(height, width),
        mean_dn=_thin_mean(taken, rungs),
        valid=maps.valid.reshape(height, width),
        counts=periods,
        steps=steps,
        unwrapping=unwrapping,
        noise=noise,
        least_modulation_dn=least,
    )


def wrapped_phases(frames: npt.ArrayLike, *, response: CameraResponse | None = None) -> WrappedPhases:
    """Find the wrapped phase, modulation and mean of every set by itself.

    Parameters
    ----------
    frames
        (sets, steps, H, W) uint8, uint16 or float32, as for `decode`.
    response
        Camera response that is applied first.

    Raises
    ------
    FramesError
        Wrong shape or type, too few steps, values that are masked or not finite.
    MeasurementError
        A ``response`` of another type.

    Notes
    -----
    The paper, eq. (2), with steps that add: phase = atan2(-sum I_n sin(2 pi n / N), sum I_n cos(2 pi n / N)).
    """
    taken = checked_frames(frames, response)
    sets, steps, height, width = taken.values.shape
    maps = tuple(np.empty((sets, height, width), np.float32) for _ in range(3))
    waves = _waves(steps)
    for first, last in chunks(0, chunk_count(taken), taken):
        linear = taken.linear(taken.raw(first, last))
        pixels = (last - first) * width
        phase, modulation = np.empty((2, sets, pixels), np.float32)
        wrap_pixels(_flat(linear), *waves, _f(taken.rounding_dn), phase, modulation)
        mean = linear.mean(axis=1, dtype=np.float32)
        for whole, part in zip(maps, (phase, modulation, mean), strict=True):
            whole[:, first:last] = part.reshape(sets, last - first, width)
    return WrappedPhases(*maps)


@dataclass(frozen=True, slots=True)
class _Settings:
    """What the kernel is told beside the frames."""

    sines: Floats
    cosines: Floats
    rungs: Rungs
    gates: Gates


def _settings(frames: Frames, rungs: Ladder, least_modulation_dn: float) -> _Settings:
    sines, cosines = _waves(frames.values.shape[1])
    folded = np.isfinite(rungs.period_turns)
    return _Settings(
        sines,
        cosines,
        Rungs(
            np.array(rungs.sets, np.int64),
            rungs.beats,
            _f(rungs.lowest_turns),
            np.array(rungs.ratios, np.float32),
            np.array(rungs.corrections, np.float32),
        ),
        Gates(
            _f(least_modulation_dn),
            _f(RESIDUAL_MARGIN_TURNS),
            _brightest(frames),
            _f(0 if folded else -np.inf),
            _f(rungs.period_turns),
            _f(rungs.period_turns),
        ),
    )


def _brightest(frames: Frames) -> Any:
    """Largest value that is not saturated, of the type that the kernel reads."""
    if frames.response is not None:
        return _f(np.inf)
    kind = frames.values.dtype.newbyteorder("=").type
    if kind is np.float32:
        return np.nextafter(_f(frames.saturation_dn), _f(-np.inf)) if frames.saturation_dn < np.inf else _f(np.inf)
    return kind(min(np.ceil(frames.saturation_dn) - 1, np.iinfo(kind).max))


def _waves(steps: int) -> tuple[Floats, Floats]:
    shifts = 2 * np.pi * np.arange(steps) / steps
    return np.sin(shifts).astype(np.float32), np.cos(shifts).astype(np.float32)


def _flat(values: Values) -> Values:
    flat = values.reshape(-1)
    # Numba compiles read-only and writeable arrays apart: one kind is enough.
    flat.flags.writeable = False
    return flat


def _noise(frames: Frames, rungs: Ladder) -> NoiseModel:
    raw = sample_cells(frames.values, frames.saturation_dn)
    cells = np.ascontiguousarray(frames.linear(raw), dtype=np.float32)
    return estimate_noise(cells, rungs, frames.least_variance_dn2)


def _thin_mean(frames: Frames, rungs: Ladder) -> Floats:
    """Mean of the finest set at few pixels: what the shot noise of all of them follows from."""
    stride = thinning(*frames.values.shape[2:])
    few = frames.linear(np.ascontiguousarray(frames.values[rungs.sets[-1], :, ::stride, ::stride]))
    return np.asarray(few.mean(axis=0, dtype=np.float32))


def _decode_in_place(flat: Values, settings: _Settings, maps: Maps, threads: int) -> float:
    """Decode flat frames where they lie; returns the largest value."""
    pixels = maps.valid.size
    tops: list[float] = []

    def work(first: int, last: int) -> None:
        a, b = first * BLOCK, min(last * BLOCK, pixels)
        tops.append(_call(flat, settings, _part(maps, a, b), a))

    blocks = -(-pixels // BLOCK)
    over_rows(blocks, min(threads, blocks), work)
    return max(tops)


def _decode_copies(frames: Frames, settings: _Settings, maps: Maps, threads: int) -> float:
    """Decode frames that must be copied first (layout, byte order, response); returns the largest value."""
    width = frames.values.shape[3]
    tops: list[float] = []

    def work(first: int, last: int) -> None:
        for top_row, end_row in chunks(first, last, frames):
            raw = frames.raw(top_row, end_row)
            part = _part(maps, top_row * width, end_row * width)
            tops.append(_call(_flat(frames.linear(raw)), settings, part, 0))
            if frames.response is not None:
                peak = raw.max(axis=(0, 1)).reshape(-1)
                tops[-1] = float(peak.max())
                part.valid[peak >= frames.saturation_dn] = False
                part.phase_rad[~part.valid] = np.nan

    number = chunk_count(frames)
    over_rows(number, min(threads, number), work)
    return max(tops)


def _call(flat: Values, settings: _Settings, maps: Maps, first: int) -> float:
    s = settings
    return float(decode_pixels(flat, s.sines, s.cosines, s.rungs, s.gates, maps, first))


def _maps(height: int, width: int, out: AbsolutePhase | None) -> Maps:
    pixels = height * width
    if out is None:
        return Maps(np.empty(pixels, np.float32), np.empty(pixels, np.float32), np.empty(pixels, np.bool_))
    if not isinstance(out, AbsolutePhase):
        raise MeasurementError(f"out must be a result of decode, got {type(out).__name__}")
    shape = (height, width)
    return Maps(
        _reused("phase_rad", out.phase_rad, shape, np.float32),
        _reused("modulation_dn", out.modulation_dn, shape, np.float32),
        _reused("valid", out.valid, shape, np.bool_),
    )


def _reused(name: str, array: object, shape: tuple[int, int], kind: type[np.generic]) -> Values:
    """Flat view of an array of an earlier result; raises MeasurementError if it cannot be overwritten."""
    if not isinstance(array, np.ndarray):
        raise MeasurementError(f"out.{name} must be an array, got {type(array).__name__}")
    if array.shape != shape:
        raise MeasurementError(f"out is a result of shape {array.shape} ({name}), the frames are {shape}")
    if array.dtype != kind:
        raise MeasurementError(f"out.{name} must be {kind.__name__}, got {array.dtype}")
    if not array.flags.carray:
        raise MeasurementError(f"out.{name} must be C-contiguous, aligned and writeable")
    return np.asarray(array).reshape(-1)


def _part(maps: Maps, first: int, last: int) -> Maps:
    return Maps(maps.phase_rad[first:last], maps.modulation[first:last], maps.valid[first:last])
