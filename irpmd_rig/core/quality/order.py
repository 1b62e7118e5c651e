"""Frames out of place: which order of the recorded frames, or which frame left out, makes them fringes."""

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from irpmd_rig.core.quality.model import Misfit, misfit
from irpmd_rig.core.quality.sets import OneSet, fit_one

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
OrderKind = Literal["as recorded", "wrong", "dropped", "repeated", "swapped"]

SUSPICIOUS = 0.03
SUSPICIOUS_NOISE = 2.0
NOISE_KNOWN = 0.1
"""A frame out of place costs at least 0.15 of the modulation (RMS). None is looked for if the misfit is below
SUSPICIOUS of it, or below SUSPICIOUS_NOISE noise variances if the noise is below NOISE_KNOWN of it."""

SURE = 0.99
"""Confidence against 'as recorded' below which no order is accepted."""

SCREEN_PIXELS = 500
DECIDE_PIXELS = 4000
FINALISTS = 6
SUSPECTS = 16
SETTLED = 0.02
"""Swaps between sets are not tried if another fault lowers the misfit to this, or to a harmless one."""

NO_BETTER = 0.93
"""If no single fault lowers the misfit below this, two faults are not looked for either."""

MUCH_BETTER = 0.7
MUCH_BETTER_AGAIN = 0.5
CLEARLY_BEST = 0.85
OVERWHELMING = 0.4
"""An order is accepted if its misfit (squares) is below MUCH_BETTER (a second fault: MUCH_BETTER_AGAIN) of the
misfit as recorded and below
CLEARLY_BEST of the runner-up's, or below OVERWHELMING of the misfit as recorded (then a rival may exist, and
the confidence says so)."""

ROUNDS = 3
ROUNDING = 1e-6
FEWEST_FREEDOM = 2
"""Agreement of phases alone with less redundancy than this proves nothing: orders adapt to it."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way in which the recorded frames could belong to their places.

    Attributes
    ----------
    source
        (frames,): index of the recorded frame that belongs at each place, -1 where none was recorded.
    frames
        The places that the hypothesis names.
    """

    kind: OrderKind
    source: Integers
    frames: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Verdict:
    """An accepted hypothesis, how sure it is, and the misfit that remains."""

    hypothesis: Hypothesis
    confidence: float
    variance_dn2: float


def likely_faults(source: Integers, steps: int) -> list[Hypothesis]:
    """One fault more than `source` already has: a wrong, lost or repeated frame, a swap within a set."""
    size = source.size
    kept = np.flatnonzero(source >= 0)
    found = [Hypothesis("wrong", _without(source, (m,)), (m,)) for m in kept.tolist()]
    for m in range(size - 1):
        late = np.concatenate([source[:m], [-1], source[m:-1]])
        found.append(Hypothesis("dropped", late, (m,)))
        early = np.concatenate([source[:m], source[m + 1 :], [-1]])
        found.append(Hypothesis("repeated", early, (m,)))
    found += swaps(source, [p for p in combinations(kept.tolist(), 2) if p[0] // steps == p[1] // steps])
    # A set of which only two frames are left adapts to the others: it would explain too much.
    fewest = min(3, steps - 1)
    return [h for h in found if ((h.source.reshape(-1, steps) >= 0).sum(axis=1) >= fewest).all()]


def swaps(source: Integers, pairs: list[tuple[int, int]]) -> list[Hypothesis]:
    """Swaps of two frames."""
    found = []
    for pair in pairs:
        swapped = source.copy()
        swapped[list(pair)] = source[list(pair[::-1])]
        found.append(Hypothesis("swapped", swapped, pair))
    return found


def two_wrong(source: Integers, pairs: list[tuple[int, int]]) -> list[Hypothesis]:
    """Two wrong frames."""
    return [Hypothesis("wrong", _without(source, pair), pair) for pair in pairs]


def _without(source: Integers, places: tuple[int, ...]) -> Integers:
    changed = source.copy()
    changed[list(places)] = -1
    return changed


class Court:
    """Judges hypotheses on sub-sampled pixels: (sets, steps, pixels), ordered by tile."""

    def __init__(self, values: Floats, tile: Integers, counts: Floats, floor_dn2: float):
        self._shape = values.shape[:2]
        self._values = values.reshape(-1, values.shape[2])
        self._tile = tile
        self._counts = counts
        self._floor = floor_dn2
        self._fitted: dict[tuple[int, ...], OneSet] = {}

    @property
    def steps(self) -> int:
        """Steps a set."""
        return int(self._shape[1])

    def judge(self, hypothesis: Hypothesis, pixels: int) -> tuple[Misfit | None, Integers]:
        """Misfit of a hypothesis, and the tiles of the pixels that it was taken from."""
        step = max(1, self._values.shape[1] // pixels)
        values = self._values[:, ::step]
        present = (hypothesis.source >= 0).reshape(self._shape)
        moved = values[np.maximum(hypothesis.source, 0)].reshape(*self._shape, -1)
        usable = np.flatnonzero(present.sum(axis=1) >= 3).tolist()
        known = {k: self._fit(step, moved[k], hypothesis.source, k) for k in usable}
        between = self._shape[0] > 1
        return misfit(moved, present, self._counts, between=between, known=known), self._tile[::step]

    def _fit(self, step: int, values: Floats, source: Integers, k: int) -> OneSet:
        """Fit a set, or remember: most hypotheses leave most sets as others do."""
        own = source[k * self.steps : (k + 1) * self.steps]
        key = (step, *own.tolist())
        if key not in self._fitted:
            self._fitted[key] = fit_one(values, tuple(np.flatnonzero(own >= 0).tolist()))
        return self._fitted[key]

    def score(self, hypothesis: Hypothesis, pixels: int) -> float:
        """Trimmed misfit variance, never below what rounding costs; infinite if it cannot be judged."""
        result, _ = self.judge(hypothesis, pixels)
        if result is None or not result.complete or (self.steps == 3 and result.freedom < FEWEST_FREEDOM):
            return np.inf
        return float(result.clipped().mean()) + self._floor

    def confidence(self, better: Hypothesis, worse: Hypothesis) -> float:
        """Probability that one hypothesis fits better than another, from the scatter of the tiles."""
        one, tile = self.judge(better, DECIDE_PIXELS)
        two, _ = self.judge(worse, DECIDE_PIXELS)
        if one is None or two is None:
            return 0.5
        gain = two.clipped() - one.clipped()
        # Hypotheses that differ by a constant phase alone fit alike up to rounding: a draw.
        return 0.5 if abs(gain.mean()) < ROUNDING * two.clipped().mean() else sure(gain, tile)

    def same(self, one: Hypothesis, two: Hypothesis, variance_dn2: float) -> bool:
        """Whether two hypotheses put frames of the same content in all places (a frame and its copy)."""
        if not np.array_equal(one.source < 0, two.source < 0):
            return False
        step = max(1, self._values.shape[1] // SCREEN_PIXELS)
        places = one.source != two.source
        difference = self._values[one.source[places], ::step] - self._values[two.source[places], ::step]
        return bool(((difference**2).mean(axis=1) < 4 * variance_dn2).all())


def sure(gain: Floats, tile: Integers) -> float:
    """One-sided normal probability that the mean of `gain` over the pixels is positive, by tiles."""
    number = np.bincount(tile)
    total = np.bincount(tile, weights=gain)[number > 0]
    number = number[number > 0]
    scatter = np.sqrt(((total - number * gain.mean()) ** 2).sum())
    if scatter == 0 or number.size < 2:
        return 0.5 if gain.sum() == 0 else float(gain.sum() > 0)
    return float(ndtr(total.sum() / (scatter * np.sqrt(number.size / (number.size - 1)))))


def find_orders(
    court: Court, size: int, modulation_dn: float, noise_dn: float
) -> tuple[Integers, list[Verdict], float]:
    """Faults of order, one after the other, each accepted only if it explains most of the misfit.

    Parameters
    ----------
    court
        The pixels.
    size
        Number of frames.
    modulation_dn
        Typical modulation.
    noise_dn
        Noise, or more than it.

    Returns
    -------
    source
        (size,): recorded frame that belongs at each place, -1 for none.
    verdicts
        The accepted hypotheses.
    score
        Misfit variance (DN^2) that remains; zero if there was nothing to look for.
    """
    harmless = (SUSPICIOUS * modulation_dn) ** 2
    if noise_dn < NOISE_KNOWN * modulation_dn:
        harmless = max(harmless, SUSPICIOUS_NOISE * noise_dn**2)
    present = Hypothesis("as recorded", np.arange(size), ())
    verdicts: list[Verdict] = []
    base = court.score(present, DECIDE_PIXELS)
    while np.isfinite(base) and len(verdicts) < ROUNDS:
        if base < harmless:
            return present.source, verdicts, 0.0
        wanted = MUCH_BETTER_AGAIN if verdicts else MUCH_BETTER
        verdict = _next(court, present, base, wanted, harmless)
        if verdict is None:
            break
        verdicts.append(verdict)
        present = verdict.hypothesis
        base = court.score(present, DECIDE_PIXELS)
    return present.source, verdicts, base


def _next(court: Court, present: Hypothesis, base: float, wanted: float, harmless: float) -> Verdict | None:
    """One more fault: the many unlikely ones are tried only if no likely one explains nearly everything."""
    rivals = likely_faults(present.source, court.steps)
    if len(rivals) < 2:
        return None
    screened = [court.score(h, SCREEN_PIXELS) for h in rivals]
    likely = _finalists(court, rivals, screened)
    pairs = _suspect_pairs(rivals, screened, court.steps)
    lowest = min(score for _, score in likely)
    if court.steps > 3 and lowest > NO_BETTER * base:
        return None
    if lowest > max(SETTLED * base, harmless):
        far = swaps(present.source, [p for p in pairs if p[0] // court.steps != p[1] // court.steps])
        likely += _finalists(court, far, [court.score(h, SCREEN_PIXELS) for h in far])
    verdict = _decide(court, present, likely, base, wanted)
    if verdict is None and pairs:
        both = two_wrong(present.source, pairs)
        finalists = _finalists(court, both, [court.score(h, SCREEN_PIXELS) for h in both])
        verdict = _decide(court, present, finalists, base, wanted)
    return verdict


def _suspect_pairs(rivals: list[Hypothesis], scores: list[float], steps: int) -> list[tuple[int, int]]:
    """Pairs of frames of which each alone, left out, helps; three steps give no hint, all pairs are taken."""
    singles = [(s, h.frames[0]) for s, h in zip(scores, rivals, strict=True) if h.kind == "wrong"]
    number = SUSPECTS if steps > 3 else len(singles)
    return list(combinations(sorted(m for _, m in sorted(singles)[:number]), 2))


def _finalists(court: Court, rivals: list[Hypothesis], screened: list[float]) -> list[tuple[Hypothesis, float]]:
    """Pick the best of many by their scores on few pixels, with their scores on more."""
    best = np.argsort(screened, kind="stable")[:FINALISTS]
    return [(rivals[i], court.score(rivals[i], DECIDE_PIXELS)) for i in best]


def _decide(
    court: Court,
    present: Hypothesis,
    finalists: list[tuple[Hypothesis, float]],
    base: float,
    wanted: float,
) -> Verdict | None:
    """Accept the best if it is good enough; among equals the one that keeps most of the frames."""
    lowest = min(score for _, score in finalists)
    equals = [h for h, score in finalists if CLEARLY_BEST * score <= lowest]
    best = max(equals, key=lambda h: ((h.source >= 0).sum(), (h.source == np.arange(h.source.size)).sum()))
    if not lowest < wanted * base:
        return None
    if court.confidence(best, present) < SURE:
        return None
    rivals = [
        (h, score)
        for h, score in finalists
        if not np.array_equal(h.source, best.source) and not court.same(h, best, lowest)
    ]
    if rivals and lowest > CLEARLY_BEST * min(s for _, s in rivals) and lowest > OVERWHELMING * base:
        return None
    sureness = min(court.confidence(best, h) for h in [present, *(h for h, _ in rivals)])
    result, _ = court.judge(best, DECIDE_PIXELS)
    variance = np.nan if result is None else result.variance_dn2()
    return Verdict(best, sureness, variance)
