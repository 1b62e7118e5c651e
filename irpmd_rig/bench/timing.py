"""Timing of candidates side by side: machines are noisy, ratios taken in one run are not."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure beside its baseline from the same run.

    Attributes
    ----------
    name
        What was measured.
    value, unit
        Its median.
    baseline, baseline_value
        What it is compared with, and its median in the same unit.
    ratio
        How they compare, in the direction that ``sense`` says.
    sense
        ``"at least"``: the ratio is baseline over value, larger is better; ``"at most"``: the inverse;
        ``"value at most"``: the limits are for the value itself, the ratio is as for "at least".
    must, aim
        What has to be reached and what is meant to be reached; None where no figure is set.
    """

    name: str
    value: float
    unit: str
    baseline: str
    baseline_value: float
    ratio: float
    sense: Literal["at least", "at most", "value at most"]
    must: float | None
    aim: float | None

    def reaches(self, limit: float | None) -> bool:
        """Whether a limit is kept; a limit that is not set is kept."""
        if limit is None:
            return True
        if self.sense == "value at most":
            return self.value <= limit
        return self.ratio >= limit if self.sense == "at least" else self.ratio <= limit


def median_ms(candidates: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Time candidates in turns, so that a change of the machine's speed meets all of them.

    Each is called once before (compilation, caches); results are let go outside the timed span, so that every
    call allocates its own.

    Returns
    -------
    dict
        Median wall time of each candidate in ms.
    """
    for candidate in candidates.values():
        candidate()
    spans: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repeats):
        for name, candidate in candidates.items():
            start = time.perf_counter()
            result = candidate()
            spans[name].append(time.perf_counter() - start)
            del result
    return {name: 1e3 * statistics.median(times) for name, times in spans.items()}


def faster(name: str, medians: Mapping[str, float], baseline: str, must: float | None, aim: float | None) -> Row:
    """Row that says how many times faster ``name`` is than ``baseline``."""
    value, base = medians[name], medians[baseline]
    return Row(name, value, "ms", baseline, base, base / value, "at least", must, aim)


def slower(name: str, medians: Mapping[str, float], baseline: str, must: float | None, aim: float | None) -> Row:
    """Row that says how many times longer ``name`` takes than ``baseline``."""
    value, base = medians[name], medians[baseline]
    return Row(name, value, "ms", baseline, base, value / base, "at most", must, aim)
