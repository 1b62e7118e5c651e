"""What is taken, run by run: every recipe in the order in which calibrations serve it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irpmd_rig.bench.accuracy_lab import Order
from irpmd_rig.bench.accuracy_worlds import Change, rig_facts, write_world
from irpmd_rig.demo.paper import TABLE_2, TABLE_3
from irpmd_rig.reproduce.recipes import CAMERA, PAPER, PRECISE, VISIBLE, Way, paper_with

PARTS = ("tables", "figures", "repeatability", "sweeps")
"""What can be reproduced: the paper's tables, its figures, and what it leaves out."""

REPEATS = 20
READ_NOISE = (1.0, 4.0, 8.0, 12.0)
"""How many times the read noise is in a sweep: shot noise is eight times as large, so that little is changed by two."""
TILTS_DEG = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
COUNTS = (16, 36, 64, 100)

STEP, FAN, FREEFORM = "mirror_step_y", "fan_y", "freeform"
_PLATES = tuple(10.0 * k for k in range(21))
# Where neither d nor the plate is looked at.
_FEW_PLATES = tuple(40.0 * k for k in range(6))
_NOMINAL: dict[str, tuple[float, ...]] = {STEP: TABLE_2.actual_mm, FAN: TABLE_3.actual_mm, FREEFORM: ()}


@dataclass(frozen=True, slots=True)
class Task(Order):
    """An order, and what its result is for.

    Attributes
    ----------
    key
        What is measured and how, as it is called in file names and in JSON; the same for repetitions.
    use
        ``calibration``, ``paper``, ``visible``, ``precise``, ``repeat``, ``read-noise``, ``stage-tilt`` or
        ``fringe-count``.
    subject
        Object that is measured; empty for calibrations and references.
    at
        What a sweep changes, e.g. degrees; 0 where nothing is swept.
    """

    key: str
    use: str
    subject: str = ""
    at: float = 0.0


class Scheme:
    """All runs of a reproduction.

    Parameters
    ----------
    seed
        Of the world's misalignment and of all noise.
    folder
        Where world files are written.
    parts
        Of `PARTS`.
    """

    def __init__(self, seed: int, folder: Path, parts: Sequence[str]) -> None:
        self._seed = seed
        self._folder = folder
        self._parts = frozenset(parts)
        self._runs = 0
        self._world, self._rig = folder, dict[str, Any]()

    def tasks(self) -> Iterator[Task]:
        """Runs in order; each uses the last calibrations and the last reference before it."""
        objects = self._objects()
        self._enter("world", Change())
        yield self._task("camera", CAMERA)
        yield self._task("plate", PAPER.plate(_PLATES))
        yield self._task("geometry", PAPER.geometry())
        yield self._task("reference", PAPER.reference())
        yield from (self._measure(subject, PAPER, "paper") for subject in objects)
        if "repeatability" in self._parts:
            yield from (self._measure(STEP, PAPER, "repeat", number + 1) for number in range(REPEATS))
        if "sweeps" in self._parts:
            yield from self._noisier()
        if "tables" in self._parts:
            self._enter("world", Change())
            yield self._task("reference-visible", PAPER.reference(VISIBLE))
            yield self._measure(FAN, PAPER, "visible", led=VISIBLE)
        if objects:
            yield from self._precise(objects)
        if "sweeps" in self._parts:
            yield from self._tilted()
            yield from self._counted()

    def _objects(self) -> tuple[str, ...]:
        if "figures" in self._parts:
            return STEP, FAN, FREEFORM
        return (STEP, FAN) if "tables" in self._parts else ()

    def _precise(self, objects: Sequence[str]) -> Iterator[Task]:
        """By rays alone, which need no reference."""
        yield self._task("geometry-precise", PRECISE.geometry())
        yield from (self._measure(subject, PRECISE, "precise") for subject in objects)
        if "tables" in self._parts:
            yield self._measure(FAN, PRECISE, "precise-visible", led=VISIBLE)

    def _noisier(self) -> Iterator[Task]:
        """By the calibration that is there: what is asked for is the noise of a measurement."""
        for factor in READ_NOISE:
            self._enter(f"read-noise-{factor:g}", Change(read_noise=factor))
            yield self._task("reference", PAPER.reference())
            yield self._measure(STEP, PAPER, "read-noise", factor)

    def _tilted(self) -> Iterator[Task]:
        """The calibration of the plate is of another stage."""
        for tilt_deg in TILTS_DEG:
            self._enter(f"stage-tilt-{tilt_deg:g}", Change(stage_about_y_deg=tilt_deg))
            yield self._task("geometry", PAPER.geometry())
            yield self._task("reference", PAPER.reference())
            yield self._measure(STEP, PAPER, "stage-tilt", tilt_deg)

    def _counted(self) -> Iterator[Task]:
        self._enter("world", Change())
        for count in COUNTS:
            way = paper_with(count)
            yield self._task(f"plate-{count}", way.plate(_FEW_PLATES))
            yield self._task(f"geometry-{count}", way.geometry())
            yield self._task(f"reference-{count}", way.reference())
            yield self._measure(STEP, way, "fringe-count", count)

    def _measure(self, subject: str, way: Way, use: str, at: float = 0.0, led: str = "") -> Task:
        key = f"{subject}-{f'{at:g}-fringes' if use == 'fringe-count' else use}"
        if use in ("repeat", "read-noise", "stage-tilt"):
            key = f"{subject}-paper"
        return self._task(key, way.measure(subject, _NOMINAL[subject], led), use, subject, at)

    def _enter(self, name: str, change: Change) -> None:
        self._world = self._folder / f"{name}.yaml"
        self._rig = rig_facts(write_world(self._world, self._seed, change))

    def _task(self, key: str, recipe: str, use: str = "calibration", subject: str = "", at: float = 0.0) -> Task:
        self._runs += 1
        # Every run has noise of its own.
        return Task(recipe, self._world, self._rig, 1000 * self._seed + self._runs, key, use, subject, at)
