"""Parts that recipes are made of."""

from __future__ import annotations

import re
from itertools import combinations
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from irpmd_rig.core.errors import CountsError
from irpmd_rig.core.phase.counts import checked_counts, ladder
from irpmd_rig.recipes.document import Settings, complaint
from irpmd_rig.recipes.stations import Orientation

SEPARATION_MM = 0.1
"""Least distance between two positions of a stage that count as different: a hundred times the stage's accuracy."""

_ID = re.compile(r"[0-9]{8}-[0-9]{6}-[0-9a-f]{6}")
_LABEL = re.compile(r"[a-z][a-z0-9_-]{0,39}")


def _run_id(value: str) -> str:
    if value != "active" and not _ID.fullmatch(value):
        raise complaint(
            f"is neither 'active' nor the id of a run: {value[:40]!r}",
            "write active, or an id as the list of runs shows it",
        )
    return value


def _named_run(value: str) -> str:
    if not _ID.fullmatch(value):
        raise complaint(f"is no id of a run: {value[:40]!r}", "write an id as the list of runs shows it")
    return value


def _label(value: str) -> str:
    if not _LABEL.fullmatch(value):
        raise complaint(
            f"is no label: {value[:40]!r}", "begin with a letter; use a to z, 0 to 9, - and _ only, at most 40 of them"
        )
    return value


def _one_line(value: str) -> str:
    if "\n" in value or value != value.strip():
        raise complaint("has line ends, or blanks at its ends", "write it in one line")
    return value


def _apart(positions_mm: tuple[float, ...]) -> tuple[float, ...]:
    for (i, one), (j, other) in combinations(enumerate(positions_mm), 2):
        if abs(one - other) < SEPARATION_MM:
            what = f"is {other:g} mm, the same place as the {_ordinal(i)} position, {one:g} mm"
            raise complaint(what, f"give positions at least {SEPARATION_MM:g} mm apart", (j,))
    return positions_mm


def _ordinal(index: int) -> str:
    return {0: "first", 1: "second", 2: "third"}.get(index, f"{index + 1}th")


def _different(orientations: tuple[Orientation, ...]) -> tuple[Orientation, ...]:
    if "x" not in orientations or len(set(orientations)) != len(orientations):
        raise complaint("must be [x] or [x, y]: depth is computed from fringes along x", "write [x] or [x, y]")
    return orientations


def _unwrappable(counts: tuple[float, ...]) -> tuple[float, ...]:
    try:
        ladder(checked_counts(counts, len(counts)), "optimum")
    except CountsError as error:
        # What the core says after the semicolon is a choice that recipes do not have.
        what = str(error).split(";")[0]
        raise complaint(f"cannot be unwrapped: {what}", "give counts such as [64, 63, 56]") from None
    return counts


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_one_line)]
Label = Annotated[str, AfterValidator(_label)]
RunId = Annotated[str, AfterValidator(_run_id)]
"""Id of a run, or ``active``: the one that the operator activated."""

NamedRun = Annotated[str, AfterValidator(_named_run)]
"""Id of a run."""

Millimetres = Annotated[float, Field(ge=-1000, le=1000)]
Seconds = Annotated[float, Field(ge=0, le=3600)]
ExposureUs = Annotated[float, Field(gt=0, le=10_000_000)] | Literal["auto"]
"""Exposure time in microseconds, or ``auto``: measured at each station so that nothing saturates."""

PositionsMm = Annotated[tuple[Millimetres, ...], AfterValidator(_apart)]
"""Positions of one stage in millimetres, at least 0.1 mm apart."""


class Light(Settings):
    """The projector's light.

    Attributes
    ----------
    led : str
        ``infrared``, ``red``, ``green`` or ``blue``.
    intensity : float
        Fraction of the LED's full drive, above 0 and at most 0.6: more may damage the projector (erratum E0031).
    """

    led: Literal["infrared", "red", "green", "blue"]
    intensity: Annotated[float, Field(gt=0, le=0.6)]


class Fringes(Settings):
    """Fringe patterns.

    Attributes
    ----------
    counts : list of float
        Periods across the projector's width, one set of patterns each: whole numbers, the second finest one below the
        finest (optimum three-fringe selection). The paper's are 64, 63, 56.
    steps : int
        Phase steps of each set, 3 to 100: 4 in the paper; 8 removes what a gamma leaves.
    orientations : list of str
        ``[x]``: the phase grows along the projector's columns; ``[x, y]``: then also along its rows.
    """

    counts: Annotated[
        tuple[Annotated[float, Field(gt=0, le=16384)], ...],
        Field(min_length=2, max_length=20),
        AfterValidator(_unwrappable),
    ] = (64.0, 63.0, 56.0)
    steps: Annotated[int, Field(ge=3, le=100)] = 4
    orientations: Annotated[tuple[Orientation, ...], Field(min_length=1, max_length=2), AfterValidator(_different)] = (
        "x",
    )


class Settle(Settings):
    """Waiting after a motion.

    Attributes
    ----------
    time_s : float
        Seconds to wait, beside the stage's own settle time; 0 to 3600.
    """

    time_s: Seconds
