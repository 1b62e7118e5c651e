"""What the accuracy bench measures: worlds, recipes and objects of one seed, run by run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from irpmd_rig.bench.accuracy_lab import Order
from irpmd_rig.bench.accuracy_worlds import NOISE, Change, rig_facts, write_world

TREADS = {"y": ("mirror_step_y", "fan_y"), "x": ("mirror_step_x", "fan_x")}
"""The paper's Tables 2 and 3, their heights changing along either axis."""
FREEFORM = "freeform"
CASES = ("paper", "precise", "freeform", "noise", "bow", "warp")
"""The paper's recipe and the precise one on treads; both on two freeform mirrors; the paper's recipe in a world with
more noise; the precise one where the glass is bowed, and where the projector distorts as no lens model describes."""

_ALL_TREADS = (*TREADS["y"], *TREADS["x"])
_TABLE_2 = ("mirror_step_y", "mirror_step_x")
_OTHER_METHODS = "compare: [depth-equation, generalised, triangulation]"
# Positions of the plate where the calibration is not itself measured.
_FEW_PLATES = [40 * k for k in range(6)]


@dataclass(frozen=True, slots=True)
class Recipe:
    """Fringes and stage positions of reference and measurements.

    Attributes
    ----------
    steps
        Phase steps of a set, in the calibration too.
    positions_mm
        Of stage1.
    """

    steps: int
    positions_mm: tuple[float, float]

    @property
    def _fringes(self) -> str:
        return f"fringes: {{counts: [64, 63, 56], steps: {self.steps}}}"

    def geometry(self) -> str:
        """Calibration of the geometry, from the positions of the shipped recipe."""
        return f"kind: calibrate-geometry\nname: geometry\n{self._fringes}\n"

    def reference(self) -> str:
        """Reference mirror."""
        return f"kind: reference\nname: reference\npositions_mm: {list(self.positions_mm)}\n{self._fringes}\n"

    def measure(self, subject: str) -> str:
        """Measurement by the default method, the others beside it; a calibration that is off is only marked."""
        return (
            f"kind: measure\nname: {subject}\nobject: {subject}\npositions_mm: {list(self.positions_mm)}\n"
            f"{self._fringes}\n{_OTHER_METHODS}\nif_calibration_is_off: mark\n"
        )


PAPER = Recipe(4, (0.0, 40.0))
PRECISE = Recipe(8, (-60.0, 40.0))


@dataclass(frozen=True, slots=True)
class Task(Order):
    """An order, and what its result is for.

    Attributes
    ----------
    case
        Of `CASES`, with the recipe for the freeform mirrors: "freeform, paper".
    seed
        Of the world.
    subject
        Object that is measured; empty for calibrations and references.
    stage_tilt_deg
        In a sweep, tilt of the stage's axis about y.
    """

    case: str
    seed: int
    subject: str = ""
    stage_tilt_deg: float | None = None


class Plan:
    """Tasks of one seed.

    Parameters
    ----------
    seed
        Of worlds and noise.
    folder
        Where world files are written.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed = seed
        self._folder = folder
        self._runs = 0
        self._tilt_deg: float | None = None
        self._world, self._rig = folder, dict[str, Any]()

    def tasks(self, cases: Sequence[str]) -> Iterator[Task]:
        """All runs that some cases take, in the order in which calibrations serve them.

        The calibration of the camera serves every world, that of the plate all but the one with another projector.
        """
        self._enter("base", Change())
        yield self._task("kind: calibrate-camera\nname: camera\n", "calibration")
        yield self._plate(None)
        for recipe, case in ((PAPER, "paper"), (PRECISE, "precise")):
            subjects = _ALL_TREADS if case in cases else ()
            if subjects or "freeform" in cases:
                yield from self._prepared(recipe, case)
                yield from (self._task(recipe.measure(subject), case, subject) for subject in subjects)
            if "freeform" in cases:
                yield self._task(recipe.measure(FREEFORM), f"freeform, {case}", FREEFORM)
        if "noise" in cases:
            yield from self._elsewhere("noise", Change(read_noise=NOISE), PAPER)
        if "bow" in cases:
            yield from self._elsewhere("bow", Change(bow_um=20.0), PRECISE)
        if "warp" in cases:
            yield from self._elsewhere("warp", Change(warped=True), PRECISE, plate=True)

    def tilted(self, tilts_deg: Sequence[float], subject: str) -> Iterator[Task]:
        """Measurements of an object by the paper's recipe, the stage's axis tilted more and more about y."""
        self._enter("base", Change())
        yield self._task("kind: calibrate-camera\nname: camera\n", "calibration")
        yield self._plate(_FEW_PLATES)
        for tilt_deg in tilts_deg:
            self._enter(f"tilt-{tilt_deg:g}", Change(stage_about_y_deg=tilt_deg))
            yield from self._prepared(PAPER, "tilt")
            yield self._task(PAPER.measure(subject), "tilt", subject)

    def _elsewhere(self, case: str, change: Change, recipe: Recipe, *, plate: bool = False) -> Iterator[Task]:
        self._enter(case, change)
        if plate:
            yield self._plate(_FEW_PLATES)
        yield from self._prepared(recipe, case)
        yield from (self._task(recipe.measure(subject), case, subject) for subject in _TABLE_2)

    def _prepared(self, recipe: Recipe, case: str) -> Iterator[Task]:
        yield self._task(recipe.geometry(), case)
        yield self._task(recipe.reference(), case)

    def _plate(self, positions_mm: Sequence[float] | None) -> Task:
        text = "kind: calibrate-plate\nname: plate\n"
        return self._task(text if positions_mm is None else f"{text}positions_mm: {positions_mm}\n", "calibration")

    def _enter(self, name: str, change: Change) -> None:
        self._world = self._folder / f"{name}-{self.seed}.yaml"
        self._rig = rig_facts(write_world(self._world, self.seed, change))
        self._tilt_deg = change.stage_about_y_deg

    def _task(self, recipe: str, case: str, subject: str = "") -> Task:
        self._runs += 1
        # Every run has noise of its own.
        noise_seed = 1000 * self.seed + self._runs
        return Task(recipe, self._world, self._rig, noise_seed, case, self.seed, subject, self._tilt_deg)
