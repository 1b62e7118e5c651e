"""From a set of fringe counts to the ladder that resolves the fringe order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from irpmd_rig.core.errors import CountsError, MeasurementError
from irpmd_rig.core.phase.arguments import fringe_counts

Unwrapping = Literal["optimum", "hierarchical"]

RESIDUAL_MARGIN_TURNS = 0.375
"""Largest rounding residual of a rung that still counts as consistent, in turns (0.5 is the tie).

A wrong order shows a residual within the margin only if the true one is beyond 1 - 0.375 = 0.625 turns. At
the default gate (B = 14 sigma_I, N = 4, counts 64/63/56) one sigma of the residual is 0.086 turns: a correct
order is refused at 4.4 sigma, a wrong one accepted at 7.3.
"""

_GATE_SIGMAS = 14.0
_WRONG_ORDER_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class Ladder:
    """Rungs from the coarsest phase to the finest set, all in turns.

    ``sets`` names the sets in the order of the rungs, the finest last. With ``beats`` the phase of a rung
    is that of the finest set minus that of the rung's own; the last rung is always the finest set itself.
    The absolute phase u of rung j is ``p_j + n`` with ``n = rint(ratio * u_{j-1} - p_j)``; ``corrections``
    weigh the rungs' rounding residuals into the noise-weighted mean of all sets.
    """

    sets: tuple[int, ...]
    beats: bool
    lowest_turns: float
    ratios: tuple[float, ...]
    corrections: tuple[float, ...]
    period_turns: float
    """Absolute phases are folded into 0..period; infinite where they are not periodic."""
    amplifications: tuple[float, ...]
    """One sigma of each rung's residual over one sigma of a wrapped phase."""

    def gate(self, steps: int) -> float:
        """Least modulation, in sigmas of a pixel's value, at which the orders can be trusted.

        14 as measured for the optimum sets (physics notes, section 3), more where a rung is so
        steep that a wrong order would pass ``RESIDUAL_MARGIN_TURNS`` at less than five sigma.
        """
        steepest = max(self.amplifications, default=0.0)
        room_rad = 2 * np.pi * (1 - RESIDUAL_MARGIN_TURNS)
        return max(_GATE_SIGMAS, _WRONG_ORDER_SIGMAS * steepest * float(np.sqrt(2 / steps)) / room_rad)


def checked_counts(counts: Sequence[float], sets: int) -> tuple[float, ...]:
    """Return the counts as floats: numbers above zero, all different, one for each set of frames."""
    periods = fringe_counts(counts)
    if periods.size != sets:
        raise CountsError(f"{periods.size} fringe counts were given for frames of {sets} sets")
    if np.unique(periods).size != periods.size:
        raise CountsError(f"fringe counts must differ from each other, got {_listed(periods)}")
    return tuple(float(count) for count in periods)


def usual_unwrapping(counts: Sequence[float]) -> Unwrapping:
    """How counts are meant: from coarse to fine where one set has no more than a period, else by beats."""
    return "hierarchical" if min(counts) <= 1 else "optimum"


def ladder(counts: tuple[float, ...], unwrapping: Unwrapping) -> Ladder:
    """Ladder of a set of counts; raises CountsError where the method cannot use them."""
    if not isinstance(unwrapping, str) or unwrapping not in ("optimum", "hierarchical"):
        raise MeasurementError(f"unwrapping must be 'optimum' or 'hierarchical', got {unwrapping!r}")
    return _optimum(counts) if unwrapping == "optimum" else _hierarchical(counts)


def _optimum(counts: tuple[float, ...]) -> Ladder:
    hint = "; unwrapping='hierarchical' takes any counts whose coarsest is at most 1"
    if len(counts) < 2:
        raise CountsError(f"the optimum method needs at least 2 sets, got {len(counts)}{hint}")
    if any(count != round(count) for count in counts):
        raise CountsError(f"the optimum method needs whole fringe counts, got {_listed(counts)}{hint}")
    order = tuple(int(k) for k in np.argsort(counts)[::-1])
    finest = counts[order[0]]
    beats = [finest - counts[k] for k in order[1:]]
    if beats[0] != 1:
        raise CountsError(
            f"the optimum method needs a set one count below the finest: the finest of {_listed(counts)} "
            f"is {finest:g}, the next {beats[0]:g} below{hint}"
        )
    rungs = [*beats, finest]
    ratios = [fine / coarse for coarse, fine in pairwise(rungs)]
    return Ladder(
        sets=(*order[1:], order[0]),
        beats=True,
        lowest_turns=0.0,
        ratios=tuple(ratios),
        corrections=_weighted_mean(counts, order, rungs),
        period_turns=finest,
        amplifications=tuple(
            # A beat's phase t0 - tk and the next rung's share the noise of t0.
            float(np.sqrt(2 * r**2 - 2 * r + (1 if j == len(ratios) - 1 else 2)))
            for j, r in enumerate(ratios)
        ),
    )


def _weighted_mean(counts: tuple[float, ...], order: tuple[int, ...], rungs: list[float]) -> tuple[float, ...]:
    # With r_i = (beat i) - D_i/c0 * phi_0 the mean of c0/c_k phi_k, weighted by c_k^2, is
    # phi_0 - sum g_i r_i, g_i = c_i c0 / sum c^2; and r_i = D_i/D_{i+1} (residual_i + r_{i+1}).
    finest = rungs[-1]
    norm = sum(count**2 for count in counts)
    weights = [counts[k] * finest / norm for k in order[1:]]
    return tuple(sum(weights[i] * rungs[i] / rungs[j + 1] for i in range(j + 1)) for j in range(len(weights)))


def _hierarchical(counts: tuple[float, ...]) -> Ladder:
    order = tuple(int(k) for k in np.argsort(counts))
    rungs = [counts[k] for k in order]
    if rungs[0] > 1:
        raise CountsError(
            f"hierarchical unwrapping starts at a set of at most 1 period; the coarsest of "
            f"{_listed(counts)} is {rungs[0]:g}"
        )
    ratios = tuple(fine / coarse for coarse, fine in pairwise(rungs))
    whole = rungs[0] == 1 and all(count == round(count) for count in counts)
    return Ladder(
        sets=order,
        beats=False,
        # A set of c < 1 periods leaves 1 - c of the turn unused: the cut lies in the middle of that gap, so
        # that noise at either end of the projector does not wrap.
        lowest_turns=-0.5 * (1 - rungs[0]),
        ratios=ratios,
        corrections=(0.0,) * len(ratios),
        period_turns=rungs[-1] if whole else float("inf"),
        amplifications=tuple(float(np.hypot(r, 1)) for r in ratios),
    )


def _listed(counts: Sequence[float] | np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return ", ".join(f"{count:g}" for count in counts)
