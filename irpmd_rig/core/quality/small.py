"""Small faults that leave every frame in its place: a blend with the previous frame, a change of brightness.

To first order each fault adds a known pattern times one unknown number to one frame. What of the pattern is
not absorbed by each pixel's own offset, modulations and coordinate is compared with the residual of the
frames by least squares over all pixels, beside legitimate patterns (harmonics of the fringes from gamma and
rounding, drift of the light from set to set). Significance comes from the scatter over tiles of the picture.

A memoryless response cannot pretend a blend: it makes the n-th harmonic over the steps only from harmonics
n, n +- N, ... of the phase, a blend makes it from the first.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.model import SetFits, common_coordinate, fit_sets
from irpmd_rig.core.quality.order import sure

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]
Complexes = NDArray[np.complex128]
SmallKind = Literal["blended", "brightness"]

VALUES = 48_000
"""Values (pixels times frames) that the least squares uses."""

ORDERS_SAFE_SIGMAS = 12.0
FEWEST_SAFE = 1000
"""Pixels with less modulation may have wrong orders, which bend their residuals: they are used only if
fewer than this have more and a set has no redundancy of its own."""

SIGNIFICANT_SIGMAS = 6.0
UNEVEN = 0.35
UNEVEN_BLEND = 0.1
"""A set is uneven if the mean of exp(i phase) or exp(2 i phase) over the pixels is above UNEVEN (the picture
shows little of a coarse fringe): harmonics and faults then look alike. No changes of brightness and only
blends from UNEVEN_BLEND on are looked for there."""

FIRST_LOOK = 0.4
REFINEMENTS = 3
"""A blend bends fringe orders, which hides a part of it: faults are taken up from FIRST_LOOK of the limits,
and their sizes are improved on corrected frames."""

MAXIMUM = 8
"""Number of small faults after which looking for more makes no sense: the whole measurement is bad."""

LEFT_OVER = 0.1
"""A pattern of which the pixels' own unknowns and the faults found so far absorb all but this is not told
apart from them."""


@dataclass(frozen=True, slots=True)
class SmallFault:
    """A fault of one frame: its kind, place in display order, size and confidence."""

    kind: SmallKind
    frame: int
    size: float
    confidence: float
    rms_dn: float


@dataclass(frozen=True, slots=True)
class SmallLimits:
    """Smallest share of the previous frame, and smallest relative brightness change, that are reported."""

    blended: float
    brightness: float

    def reported(self, pattern: "_Pattern", size: float) -> bool:
        """Whether a fault is large enough; a blend of negative share is impossible."""
        if pattern.kind == "brightness":
            return abs(size) > self.brightness
        return size > (max(self.blended, UNEVEN_BLEND) if pattern.uneven else self.blended)


@dataclass(frozen=True, slots=True)
class _Pattern:
    """A fault of unit size.

    Attributes
    ----------
    same
        The brightness changes by the same everywhere (ambient light).
    uneven
        The pattern is made of fringes of which the picture shows little.
    """

    kind: SmallKind
    frame: int
    same: bool = False
    uneven: bool = False

    def values(self, expected: Floats) -> Floats:
        """(pixels,) change of the frame, from (frames, pixels) as they should be."""
        frame: Floats = expected[self.frame]
        if self.kind == "blended":
            previous: Floats = expected[self.frame - 1]
            return previous - frame
        return np.full(frame.size, frame.mean()) if self.same else frame


@dataclass(frozen=True, slots=True)
class _State:
    """Frames of trusted pixels beside what they should be to first order.

    Attributes
    ----------
    residual
        (pixels, frames).
    expected
        (frames, pixels).
    left
        (pixels, frames, frames): what a pixel's own unknowns leave of a pattern.
    wave
        (sets, steps, pixels): exp(i phase).
    """

    residual: Singles
    expected: Floats
    left: Singles
    wave: Complexes
    fits: SetFits
    tile: Integers
    present: NDArray[np.bool_]
    between: bool


@dataclass(frozen=True, slots=True)
class _Equations:
    """Normal equations of each tile; the columns are the legitimate patterns, then the faults'."""

    gram: Floats
    right: Floats
    patterns: list[_Pattern | None]


@dataclass(frozen=True, slots=True)
class _Trial:
    """One more fault tried: its column, size, significance, gain in squares in total and by tile."""

    pattern: _Pattern
    column: int
    size: float
    sigmas: float
    gain: float
    tile_gain: Floats


def find_small(
    values: Floats,
    present: NDArray[np.bool_],
    counts: Floats,
    tile: Integers,
    *,
    noise_dn: float | None,
    limits: SmallLimits,
) -> list[SmallFault]:
    """Blends and changes of brightness, the one that explains most first.

    Parameters
    ----------
    values
        (sets, steps, pixels) in their places (DN), ordered by tile.
    present
        (sets, steps): frames that can be trusted to be the right ones at all.
    counts
        Fringe counts of the sets.
    tile
        (pixels,).
    noise_dn
        Noise if the sets' phases and means agree and may be used, otherwise None.
    limits
        Smallest sizes reported.
    """
    sets, steps, _ = values.shape
    fits = fit_sets(values, present)
    if not fits.used.all() or (noise_dn is None and steps < 4):
        return []
    between = noise_dn is not None
    chosen = np.arange(tile.size)
    if noise_dn is not None:
        safe = np.flatnonzero((np.abs(fits.z) > ORDERS_SAFE_SIGMAS * noise_dn).all(axis=0))
        if safe.size >= FEWEST_SAFE:
            chosen = safe
        elif steps > 3:
            between = False
    chosen = chosen[:: max(1, chosen.size * sets * steps // VALUES)]
    return _refined(values[..., chosen], present, counts, tile[chosen], between=between, limits=limits)


def _refined(
    values: Floats,
    present: NDArray[np.bool_],
    counts: Floats,
    tile: Integers,
    *,
    between: bool,
    limits: SmallLimits,
) -> list[SmallFault]:
    """Find faults; where they may have bent fringe orders, correct the frames and look again."""
    state = _state(values, present, counts, tile, between=between)
    share = FIRST_LOOK if between else 1.0
    found = _greedy(_equations(state), state, limits, share)
    sizes = np.array([_size(t, state) for t, _ in found])
    for _ in range(REFINEMENTS if between and found else 0):
        corrected = values
        for _ in range(2):
            fits = fit_sets(corrected, present)
            rotor = np.exp(2j * np.pi * np.arange(values.shape[1]) / values.shape[1])[:, None]
            expected = (fits.mean[:, None] + (fits.z[:, None] * rotor).real).reshape(-1, values.shape[2])
            change = np.zeros_like(expected)
            for (trial, _), size in zip(found, sizes, strict=True):
                change[trial.pattern.frame] += size * trial.pattern.values(expected)
            corrected = values - change.reshape(values.shape)
        state = _state(corrected, present, counts, tile, between=True)
        sizes = sizes + _joint(_equations(state), [t.column for t, _ in found])
    return [
        _fault(trial.pattern, float(size), confidence, state)
        for (trial, confidence), size in zip(found, sizes, strict=True)
        if limits.reported(trial.pattern, float(size))
    ]


def _joint(equations: _Equations, columns: list[int]) -> Floats:
    """Sizes of the patterns in `columns` together, beside the legitimate ones."""
    fixed = [i for i, p in enumerate(equations.patterns) if p is None] + columns
    total, right = equations.gram.sum(axis=0), equations.right.sum(axis=0)
    inverse = _scaled_inverse(total, fixed)
    sizes: Floats = (inverse @ right[fixed])[len(fixed) - len(columns) :]
    return sizes


def _scaled_inverse(total: Floats, fixed: list[int]) -> Floats:
    """Pseudo-inverse of some rows and columns of normal equations, scaled to unit diagonal first."""
    scale = np.sqrt(np.maximum(np.diag(total), 1e-30))[fixed]
    inner = total[np.ix_(fixed, fixed)] / np.outer(scale, scale)
    inverse: Floats = np.linalg.pinv(inner, rcond=1e-5, hermitian=True) / np.outer(scale, scale)
    return inverse


def _state(values: Floats, present: NDArray[np.bool_], counts: Floats, tile: Integers, *, between: bool) -> _State:
    """Linearise the frames about what they should be."""
    sets, steps, _ = values.shape
    fits = fit_sets(values, present)
    phase = np.angle(fits.z)
    if between:
        coordinate = common_coordinate(fits, counts)
        squares = (coordinate.tangential**2).sum(axis=0)
        # The rest have wrong orders or lie on edges.
        trusted = squares <= 16 * max(float(np.median(squares)), 1e-12)
        values, tile, phase = values[..., trusted], tile[trusted], coordinate.phase_rad[:, trusted]
        fits = fit_sets(values, present)
    wave = np.exp(1j * phase)[:, None] * np.exp(2j * np.pi * np.arange(steps) / steps)[:, None]
    known = fits.mean[:, None] + (fits.z[:, None] * np.exp(1j * (np.angle(wave) - phase[:, None]))).real
    # An absent frame is what its set says it is, so that it contributes nothing.
    values = np.where(present[..., None], values, known)
    left = _left_over(wave, counts[:, None] * np.abs(fits.z) if between else None)
    flat = values.reshape(sets * steps, -1)
    residual = (left @ flat.T[..., None].astype(np.float32))[..., 0]
    return _State(residual, flat - residual.T, left, wave, fits, tile, present, between)


def _left_over(wave: Complexes, slope: Floats | None) -> Singles:
    """(pixels, frames, frames) projector onto what offset, modulations and coordinate do not absorb.

    `slope`: (sets, pixels) change of the frames with the coordinate; None: each set has phase and offset of
    its own.
    """
    sets, steps, pixels = wave.shape
    unknowns = []
    for k in range(sets):
        parts = [wave[k].real]
        if slope is None:
            parts += [wave[k].imag, np.full((steps, pixels), 0.5**0.5)]
        for part in parts:
            unknown = np.zeros(wave.shape, np.float32)
            unknown[k] = part * np.sqrt(2 / steps)
            unknowns.append(unknown)
    if slope is not None:
        pull = slope[:, None] * wave.imag
        unknowns.append((pull / np.sqrt((pull**2).sum(axis=(0, 1)))).astype(np.float32))
        unknowns.append(np.full(wave.shape, (sets * steps) ** -0.5, np.float32))
    basis = np.stack(unknowns).reshape(len(unknowns), sets * steps, pixels).transpose(2, 1, 0)
    basis = np.ascontiguousarray(basis)
    projector: Singles = np.eye(sets * steps, dtype=np.float32) - basis @ basis.transpose(0, 2, 1)
    return projector


def _legitimate(state: _State) -> Singles:
    """(pixels, frames, patterns) of good frames: harmonics, also growing with the modulation, and drift."""
    modulation = np.abs(state.fits.z)
    sets, steps, pixels = state.wave.shape
    patterns = np.zeros((7 * sets, sets, steps, pixels), np.float32)
    for k in range(sets):
        second = modulation[k] * state.wave[k] ** 2
        third = modulation[k] * state.wave[k] ** 3
        relative = modulation[k] / modulation[k].mean() - 1
        parts = [second.real, second.imag, third.real, third.imag]
        parts += [relative * second.real, relative * second.imag]
        parts += [np.broadcast_to(state.fits.mean[k], second.shape)]
        patterns[7 * k : 7 * k + 7, k] = parts
    stacked = patterns.reshape(7 * sets, sets * steps, pixels).transpose(2, 1, 0)
    left: Singles = state.left @ np.ascontiguousarray(stacked)
    return left


def _fault_patterns(state: _State) -> list[_Pattern]:
    """Every fault that is looked for: in sets of which no frame is absent."""
    sets, steps, _ = state.wave.shape
    first = state.wave[:, 0]
    uneven = [max(abs((first[k] ** order).mean()) for order in (1, 2)) > UNEVEN for k in range(sets)]
    found = []
    for m in range(sets * steps):
        k = m // steps
        if not state.present[k].all():
            continue
        if not uneven[k]:
            found += [_Pattern("brightness", m), _Pattern("brightness", m, same=True)]
        if m > 0:
            found.append(_Pattern("blended", m, uneven=uneven[k] or uneven[(m - 1) // steps]))
    return found


def _equations(state: _State) -> _Equations:
    """Set up the normal equations tile by tile."""
    legitimate = _legitimate(state)
    faults = _fault_patterns(state)
    pixels, frames, first = legitimate.shape
    matrix = np.empty((pixels, frames, first + len(faults) + 1), np.float32)
    matrix[..., :first] = legitimate
    for i, pattern in enumerate(faults, first):
        values = pattern.values(state.expected).astype(np.float32)
        matrix[..., i] = state.left[:, :, pattern.frame] * values[:, None]
    matrix[..., -1] = state.residual
    edges = np.concatenate([[0], np.flatnonzero(np.diff(state.tile)) + 1, [pixels]])
    grams = []
    for start, stop in pairwise(edges.tolist()):
        block = matrix[start:stop].reshape(-1, matrix.shape[2])
        grams.append(block.T @ block)
    gram = np.stack(grams).astype(np.float64)
    return _Equations(gram[:, :-1, :-1], gram[:, :-1, -1], [None] * first + faults)


def _trials(equations: _Equations, chosen: list[int]) -> list[_Trial]:
    """Try every fault not yet chosen beside the legitimate patterns and those chosen."""
    fixed = [i for i, p in enumerate(equations.patterns) if p is None] + chosen
    total, right = equations.gram.sum(axis=0), equations.right.sum(axis=0)
    inverse = _scaled_inverse(total, fixed)
    base = np.zeros(total.shape[0])
    base[fixed] = inverse @ right[fixed]
    rest = right - total @ base
    trials = []
    for column, pattern in enumerate(equations.patterns):
        if pattern is None or column in chosen:
            continue
        direction = np.zeros(total.shape[0])
        direction[column] = 1.0
        direction[fixed] = -inverse @ total[fixed, column]
        own = direction @ total @ direction
        if own < LEFT_OVER * total[column, column] or own <= 0:
            continue
        size = float(rest[column] / own)
        unexplained = equations.right - equations.gram @ (base + 0.5 * size * direction)
        tile_gain = 2 * size * (unexplained @ direction)
        pull = (unexplained - 0.5 * size * (equations.gram @ direction)) @ direction
        scatter = float(np.sqrt((pull**2).sum() * pull.size / max(pull.size - 1, 1)) / own)
        sigmas = abs(size) / max(scatter, 1e-12)
        trials.append(_Trial(pattern, column, size, sigmas, size**2 * own, tile_gain))
    return trials


def _greedy(equations: _Equations, state: _State, limits: SmallLimits, share: float) -> list[tuple[_Trial, float]]:
    """Accept the fault that explains most, then look again beside it; with its confidence.

    `share`: part of the limits from which a fault is taken up.
    """
    chosen: list[int] = []
    found: list[tuple[_Trial, float]] = []
    for _ in range(MAXIMUM):
        able = [
            t
            for t in _trials(equations, chosen)
            if t.sigmas > SIGNIFICANT_SIGMAS and limits.reported(t.pattern, _size(t, state) / share)
        ]
        if not able:
            break
        best = max(able, key=lambda t: t.gain)
        chosen.append(best.column)
        if any(t.pattern.frame == best.pattern.frame for t, _ in found):
            continue
        name = (best.pattern.kind, best.pattern.frame)
        rivals = [t for t in able if (t.pattern.kind, t.pattern.frame) != name]
        gains = [best.tile_gain, *(best.tile_gain - t.tile_gain for t in rivals)]
        found.append((best, min(sure(g, np.arange(g.size)) for g in gains)))
    return found


def _size(trial: _Trial, state: _State) -> float:
    """Size of a trial (zero if impossible), freed of what the fault did to its own pattern.

    Without help from the other sets the pattern comes from a fit to the faulty set itself: to a known factor
    it contains the fault.
    """
    if state.between:
        return trial.size
    steps = state.present.shape[1]
    own = 3 / steps
    if trial.pattern.kind == "brightness":
        return float(trial.size / (1 - own * trial.size)) if own * trial.size < 1 else 0.0
    if trial.size <= 0:
        return 0.0
    neighbour = (1 + 2 * np.cos(2 * np.pi / steps)) / steps if trial.pattern.frame % steps else 0.0
    return float(trial.size / (1 + trial.size * (own - neighbour)))


def _fault(pattern: _Pattern, size: float, confidence: float, state: _State) -> SmallFault:
    rms = float(abs(size) * np.sqrt((pattern.values(state.expected) ** 2).mean()))
    return SmallFault(pattern.kind, pattern.frame, size, confidence, rms)
