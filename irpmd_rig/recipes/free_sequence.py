"""Stations of a free sequence."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from irpmd_rig.recipes.fields import Fringes
from irpmd_rig.recipes.models import Sequence
from irpmd_rig.recipes.stations import Location, Prompt, Scene, Shot, Station
from irpmd_rig.recipes.steps import Ask, Capture, Move, Set, Show, Step, Wait


def shots_of(fringes: Fringes, label: str) -> tuple[Shot, ...]:
    """Make the shots of fringe patterns, one an orientation."""
    return tuple(
        Shot("fringes", label, fringes.counts, fringes.steps, orientation) for orientation in fringes.orientations
    )


def free_stations(recipe: Sequence, wait_s: float, settle: Literal["timed", "measured"]) -> tuple[Station, ...]:
    """Turn the steps of a free sequence into stations.

    A station ends where something other than a picture changes: a stage, the exposure, the light being on, a prompt, a
    wait. Each names the positions of both stages, so that a run can go on from any of them.

    Parameters
    ----------
    recipe
        The sequence.
    wait_s, settle
        What is added after each motion.
    """
    walk = _Walk(recipe, wait_s, settle)
    for index, step in enumerate(recipe.steps):
        walk.take(step, ("steps", index))
    walk.close()
    return tuple(walk.stations)


@dataclass(slots=True)
class _Walk:
    recipe: Sequence
    settle_s: float
    settle: Literal["timed", "measured"]
    stations: list[Station] = field(default_factory=list)
    prompt: Prompt | None = None
    positions_mm: dict[str, float] = field(default_factory=dict)
    wait_s: float = 0.0
    moved: bool = False
    shots: list[Shot] = field(default_factory=list)
    lit: bool = False
    source: Location = ()
    picture: Show = field(default_factory=lambda: Show(do="show", pattern="plain"))
    exposure_us: float | Literal["auto"] = "auto"

    def __post_init__(self) -> None:
        self.exposure_us = self.recipe.exposure_us

    def take(self, step: Step, source: Location) -> None:
        if isinstance(step, Show):
            self.picture = step
        elif isinstance(step, Capture):
            self._capture(step, source)
        elif isinstance(step, Set):
            self._end_shots()
            self.exposure_us = step.exposure_us
        elif isinstance(step, Ask):
            # What was asked, moved or waited for before is done before this is asked.
            self.close()
            scene = None if step.subject is None else Scene(step.subject, step.pose, step.glass, step.lamp)
            self.prompt, self.source = Prompt(step.text, scene), source
        elif isinstance(step, Move):
            # Each move is a station of its own, so that moves keep their order.
            if self.shots or self.wait_s or self.moved:
                self.close()
            self.positions_mm[step.stage] = step.position_mm
            self.moved, self.source = True, source
        elif isinstance(step, Wait):
            self._end_shots()
            self.wait_s += step.time_s
            self.source = self.source or source

    def close(self) -> None:
        """End the station, if anything is in it."""
        if not (self.shots or self.prompt or self.moved or self.wait_s):
            return
        last = self.stations[-1] if self.stations else None
        positions = [self.positions_mm.get(stage) for stage in ("stage1", "stage2")]
        measured = self.settle if self.moved else "timed"
        label = self.shots[0].label if self.shots else "move" if self.moved else "wait"
        self.stations.append(
            Station(
                index=0 if last is None else last.index + 1,
                label=label,
                prompt=self.prompt,
                stage1_mm=positions[0],
                stage2_mm=positions[1],
                exposure_us=self.exposure_us,
                lit=self.lit,
                shots=tuple(self.shots),
                wait_s=self.wait_s + (self.settle_s if self.moved else 0.0),
                settle=measured,
                source=self.source,
            )
        )
        self.prompt, self.wait_s, self.moved, self.lit, self.source = None, 0.0, False, False, ()
        self.shots.clear()

    def _end_shots(self) -> None:
        if self.shots:
            self.close()

    def _capture(self, step: Capture, source: Location) -> None:
        lit = self.picture.pattern != "plain"
        if self.shots and lit != self.lit:
            self.close()
        self.lit = lit
        self.source = self.source or source
        if self.picture.pattern == "fringes":
            self.shots += shots_of(self.picture.fringes or self.recipe.fringes, step.label)
        else:
            self.shots.append(Shot(self.picture.pattern, step.label))
