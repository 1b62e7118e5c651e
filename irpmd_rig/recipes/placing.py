"""Stations that several kinds of recipes have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from irpmd_rig.recipes.fields import Fringes
from irpmd_rig.recipes.free_sequence import shots_of
from irpmd_rig.recipes.stations import Location, Prompt, Scene, Shot, Station

REFERENCE_MM = 0.0
"""Stage1 during calibration, in millimetres: frame M is defined there."""

EMPTY = Prompt(
    "Clear the object support and put the ground glass in place; lamp off.",
    Scene("nothing"),
)
MIRROR = Prompt(
    "Put the sprayed mirror on the object support; ground glass in place, lamp off.",
    Scene("mirror"),
)


def station(
    label: str,
    shots: Iterable[Shot],
    prompt: Prompt | None,
    stage1_mm: float = REFERENCE_MM,
    stage2_mm: float | None = None,
    source: Location = (),
) -> Station:
    """Make a station that the plan numbers and sets the exposure of."""
    taken = tuple(shots)
    lit = any(shot.role != "plain" for shot in taken)
    return Station(0, label, prompt, stage1_mm, stage2_mm, "auto", lit, taken, source=source)


def uniform(label: str) -> tuple[Shot, ...]:
    """Make the shots of a white and a black picture."""
    return (Shot("white", label), Shot("black", label))


def glass_and_mirror(fringes: Fringes, positions_mm: Sequence[float]) -> Iterator[Station]:
    """Lay out the mirror's stations: where the glass is seen directly is known from frames without it, at each."""
    for index, position_mm in enumerate(positions_mm):
        prompt = EMPTY if index == 0 else None
        yield station("glass", uniform("glass"), prompt, position_mm, source=("positions_mm", index))
    for index, position_mm in enumerate(positions_mm):
        prompt = MIRROR if index == 0 else None
        shots = shots_of(fringes, "mirror")
        yield station("mirror", shots, prompt, position_mm, source=("positions_mm", index))
