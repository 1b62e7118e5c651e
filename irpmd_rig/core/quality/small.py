"""Small faults that leave every frame in its place: a blend with the previous frame, a change of brightness.

The linearised faults (`irpmd_rig.core.quality.linear`) are tried one after the other; significance comes from the
scatter over tiles of the picture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.quality.linear import Equations, Pattern, SmallKind, State, linearise, normal_equations
from irpmd_rig.core.quality.order import sure
from irpmd_rig.core.quality.sets import fit_sets

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

VALUES = 48_000
"""Values (pixels times frames) that the least squares uses."""

ORDERS_SAFE_SIGMAS = 12.0
FEWEST_SAFE = 1000
"""Pixels with less modulation may have wrong orders, which bend their residuals: they are used only if
fewer than this have more and a set has no redundancy of its own."""

SIGNIFICANT_SIGMAS = 6.0
UNEVEN_BLEND = 0.1
"""In sets that are uneven no changes of brightness and only blends from UNEVEN_BLEND on are looked for."""

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

    def reported(self, pattern: Pattern, size: float) -> bool:
        """Whether a fault is large enough; a blend of negative share is impossible."""
        if pattern.kind == "brightness":
            return abs(size) > self.brightness
        return size > (max(self.blended, UNEVEN_BLEND) if pattern.uneven else self.blended)


@dataclass(frozen=True, slots=True)
class _Trial:
    """One more fault tried: its column, size, significance, gain in squares in total and by tile."""

    pattern: Pattern
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
    state = linearise(values, present, counts, tile, between=between)
    share = FIRST_LOOK if between else 1.0
    found = _greedy(normal_equations(state), state, limits, share)
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
        state = linearise(corrected, present, counts, tile, between=True)
        sizes = sizes + _joint(normal_equations(state), [t.column for t, _ in found])
    return [
        _fault(trial.pattern, float(size), confidence, state)
        for (trial, confidence), size in zip(found, sizes, strict=True)
        if limits.reported(trial.pattern, float(size))
    ]


def _joint(equations: Equations, columns: list[int]) -> Floats:
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


def _trials(equations: Equations, chosen: list[int]) -> list[_Trial]:
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


def _greedy(equations: Equations, state: State, limits: SmallLimits, share: float) -> list[tuple[_Trial, float]]:
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


def _size(trial: _Trial, state: State) -> float:
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


def _fault(pattern: Pattern, size: float, confidence: float, state: State) -> SmallFault:
    rms = float(abs(size) * np.sqrt((pattern.values(state.expected) ** 2).mean()))
    return SmallFault(pattern.kind, pattern.frame, size, confidence, rms)
