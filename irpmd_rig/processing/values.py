"""What the computing tells while it computes, and when it is done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Summary = float | int | str | list[float | None] | None


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the computing is.

    Attributes
    ----------
    text
        What is being done, for a person.
    fraction
        Share of the steps that are done, 0 to 1.
    file
        Name of a result that is complete on disk now; None if there is no new one.
    """

    text: str
    fraction: float
    file: str | None = None


@dataclass(frozen=True, slots=True)
class ProcessedRun:
    """What was computed.

    Attributes
    ----------
    run, kind
        Which run.
    uses
        Calibrations and reference that were used: kind to run id.
    files
        Names of the results on disk.
    summary
        What a list of runs shows: a few figures with their units in the names; None where one cannot be known.
    """

    run: str
    kind: str
    uses: dict[str, str]
    files: tuple[str, ...]
    summary: dict[str, Summary]


Announce = Callable[[Progress], None]
