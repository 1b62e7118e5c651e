"""From the text of a recipe to what this rig would do: read, planned, estimated, checked; nothing moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.interlocks import record_of
from irpmd_rig.acquisition.named_runs import unusable
from irpmd_rig.acquisition.rig_file import RigFile
from irpmd_rig.acquisition.status import Validation
from irpmd_rig.processing.chain import check_uses
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.recipes.check import check
from irpmd_rig.recipes.document import DocumentError, Problem, problem_at
from irpmd_rig.recipes.equipment import Equipment
from irpmd_rig.recipes.estimate import Estimate, estimate
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.plan import Plan, Station, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import shipped_recipes
from irpmd_rig.store.errors import DiskFull
from irpmd_rig.store.library import Library
from irpmd_rig.store.store import Store

INLINE = "recipe"
# Results beside the frames: maps and points, as bytes a pixel of the camera.
_RESULT_BYTES = 64


class NoSuchRecipe(AcquisitionError):
    """A name that no shipped recipe has."""


@dataclass(frozen=True, slots=True)
class RecipeText:
    """A recipe as it was given: its text, and what problems in it are named after."""

    text: str
    name: str = INLINE


@dataclass(frozen=True, slots=True)
class Order:
    """A recipe that was read, and what it takes.

    Attributes
    ----------
    text
        As given.
    problems
        What this rig cannot do of it, and which runs it names that cannot serve; empty if it may run.
    """

    text: str
    recipe: Recipe
    plan: Plan
    estimate: Estimate
    problems: tuple[Problem, ...]


def named_recipe(name: str) -> RecipeText:
    """Find a shipped recipe by its name.

    Raises
    ------
    NoSuchRecipe
        There is none; paths are not taken.
    """
    shipped = shipped_recipes()
    if name not in shipped:
        raise NoSuchRecipe(
            f"there is no recipe named {name[:60]!r}", f"use one of {', '.join(shipped)}, or give its text"
        )
    return RecipeText(shipped[name].read_text(encoding="utf-8"), f"{name}.yaml")


class Intake:
    """Reads recipes for one rig.

    Parameters
    ----------
    rig_file
        Tells the rig file, filled in.
    equipment
        Tells what the rig can do, as last known.
    positions
        Tells where the stages stand, as last known.
    store
        Where runs are kept.
    """

    def __init__(
        self,
        rig_file: Callable[[], RigFile],
        equipment: Callable[[], Equipment],
        positions: Callable[[], Mapping[str, float]],
        store: Store,
    ) -> None:
        self._rig_file = rig_file
        self._equipment = equipment
        self._positions = positions
        self._store = store

    def read(self, given: RecipeText) -> Order:
        """Read a recipe, lay it out and check it against the rig.

        Raises
        ------
        DocumentError
            It cannot be read.
        """
        recipe, document = read_recipe(given.text, given.name)
        equipment = self._equipment()
        laid_out = plan(recipe)
        takes = estimate(recipe, laid_out, equipment, self._positions())
        named = unusable(record_of(recipe, self._rig_file()), self._store)
        problems = (*check(recipe, laid_out, equipment, document), *(problem_at(document, *found) for found in named))
        return Order(given.text, recipe, laid_out, takes, problems)

    def validate(self, given: RecipeText) -> Validation:
        """Tell everything that is wrong with a recipe, and what it would take."""
        try:
            order = self.read(given)
        except DocumentError as error:
            return Validation(error.problems)
        return Validation(
            problems=order.problems,
            warnings=tuple(self._warnings(order)),
            kind=order.recipe.kind,
            name=order.recipe.name,
            estimate=order.estimate,
            stations=tuple(_line(station) for station in order.plan.stations),
        )

    def bytes_needed(self, takes: Estimate) -> int:
        """Bytes of frames and results."""
        width, height = self._equipment().camera_size_px or (2048, 2048)
        return takes.bytes + _RESULT_BYTES * width * height

    def check_space(self, *runs: Estimate) -> None:
        """Refuse what would not fit on the disk with the rig's reserve; raises DiskFull."""
        reserve_bytes = int(self._rig_file().storage.reserve_gb * 1e9)
        self._store.check_space(sum(self.bytes_needed(run) for run in runs), reserve_bytes)

    def _warnings(self, order: Order) -> list[str]:
        """What would be refused if it ran now, but may be right by the time it runs."""
        found = []
        try:
            check_uses(record_of(order.recipe, self._rig_file()), Library(self._store))
        except ProcessingError as error:
            found.append(str(error))
        try:
            self.check_space(order.estimate)
        except DiskFull as error:
            found.append(str(error))
        return found


def _line(station: Station) -> str:
    places = [
        f"{name} {place:g} mm"
        for name, place in (("stage1", station.stage1_mm), ("stage2", station.stage2_mm))
        if place is not None
    ]
    shots = [f"{shot.frames} {shot.role}" for shot in station.shots]
    prompt = [f"prompt: {station.prompt.text}"] if station.prompt else []
    return f"{station.index} {station.label}: " + "; ".join([*prompt, *places, *shots])
