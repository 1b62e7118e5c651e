"""Recipes, runs, the queue, calibrations and references."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

from fastapi import APIRouter, Header, Query, Response

from irpmd_rig.acquisition.daemon import named_recipe
from irpmd_rig.acquisition.intake import RecipeText
from irpmd_rig.acquisition.interlocks import NotReady
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.service.desk import HeldLease, TheDesk
from irpmd_rig.service.documented import BODY, DISK, RUN, problems
from irpmd_rig.service.models import Calibration, Optics, Queue, Recipe, Run, Validation
from irpmd_rig.service.orders import InlineRecipe, NamedRecipe, QueueAction, RunAction
from irpmd_rig.service.problems import Problem, ProblemError
from irpmd_rig.shipped import shipped_recipes
from irpmd_rig.store.library import REFERENCE, LibraryItem
from irpmd_rig.store.record import CALIBRATIONS

router = APIRouter()
GivenRecipe = NamedRecipe | InlineRecipe
LIST_LIMIT = 1000


# --- recipes


@router.get("/recipes", responses=problems(), tags=["recipes"])
async def recipes(desk: TheDesk) -> tuple[Recipe, ...]:
    """Recipes that ship with the program."""
    return await desk.reading(_shipped)


@router.post("/recipes/validate", responses=problems(*BODY, "no-such-recipe"), tags=["recipes"])
async def validate(desk: TheDesk, order: GivenRecipe) -> Validation:
    """Check a recipe without running it: everything that is wrong, and bytes, time and motion that it would take."""
    return Validation.model_validate(await desk.reading(lambda: desk.daemon.validate(_text(order))))


def _text(order: GivenRecipe) -> RecipeText:
    return named_recipe(order.recipe) if isinstance(order, NamedRecipe) else RecipeText(order.text)


@lru_cache(1)
def _shipped() -> tuple[Recipe, ...]:
    found = []
    for name, path in shipped_recipes().items():
        recipe, document = read_recipe(path)
        found.append(Recipe(id=name, kind=recipe.kind, name=recipe.name, text=document.text))
    return tuple(found)


# --- runs


@router.post(
    "/runs",
    status_code=201,
    responses={
        200: {"model": Run, "description": "The run that this idempotency key made earlier", "headers": (_location := {
            "Location": {"description": "Address of the run", "schema": {"type": "string"}},
        })},
        201: {"description": "A new run waits", "headers": _location},
        **problems(*BODY, *DISK, "recipe-refused", "no-such-recipe", "key-reused"),
    },
    tags=["runs"],
)  # fmt: skip
async def submit(
    desk: TheDesk,
    order: GivenRecipe,
    response: Response,
    key: Annotated[
        str | None,
        Header(alias="Idempotency-Key", description="The same key returns the same run, however often it is sent."),
    ] = None,
) -> Run:
    """Make a run of a recipe and let it wait in the queue."""
    status, new = await desk.reading(lambda: desk.daemon.submit(_text(order), key))
    response.status_code = 201 if new else 200
    response.headers["Location"] = f"/api/v1/runs/{status.id}"
    return Run.model_validate(status)


@router.get("/runs", responses=problems("invalid"), tags=["runs"])
async def runs(
    desk: TheDesk,
    limit: Annotated[int, Query(ge=1, le=LIST_LIMIT)] = 100,
    before: Annotated[str | None, Query(max_length=40, description="Only runs older than the one of this id.")] = None,
) -> tuple[Run, ...]:
    """Runs, newest first."""

    def newest() -> tuple[Run, ...]:
        found = (status for status in desk.daemon.runs() if before is None or status.id < before)
        return tuple(Run.model_validate(status) for status, _ in zip(found, range(limit), strict=False))

    return await desk.listing(newest)


@router.get("/runs/{run_id}", responses=problems(*RUN, "invalid"), tags=["runs"])
async def run(desk: TheDesk, run_id: str) -> Run:
    """One run: state, reason, progress, estimate, results."""
    return Run.model_validate(await desk.listing(desk.daemon.run, run_id))


@router.post(
    "/runs/{run_id}/actions",
    responses=problems(*BODY, *RUN, *DISK, "lease-held", "lease-needed", "action-refused", "recipe-refused"),
    tags=["runs"],
)
async def act(desk: TheDesk, run_id: str, lease: HeldLease, order: RunAction) -> Run:
    """Abort, pause, resume, answer the operator's prompt, or retry."""
    done = await desk.commanding(desk.daemon.act, run_id, order.action, lease.id, order.answer, order.prompt)
    return Run.model_validate(done)


@router.delete(
    "/runs/{run_id}", status_code=204, responses=problems(*RUN, "run-in-use", "write-failed", "invalid"), tags=["runs"]
)
async def delete(desk: TheDesk, run_id: str) -> None:
    """Delete an ended run with its folder."""
    await desk.filing(desk.daemon.delete, run_id)


# --- the queue


@router.get("/queue", responses=problems(), tags=["queue"])
async def queue(desk: TheDesk) -> Queue:
    """What waits, and whether it may start by itself."""
    return Queue.model_validate(await desk.asking(desk.daemon.queue_status))


@router.post("/queue/actions", responses=problems(*BODY, "not-ready"), tags=["queue"])
async def queue_action(desk: TheDesk, order: QueueAction) -> Queue:
    """Hold the queue, or let it go on; it is held after every start and every failure."""
    try:
        return Queue.model_validate(await desk.asking(desk.daemon.queue_action, order.action))
    except NotReady as error:
        reasons = (await desk.asking(desk.daemon.rig_status)).reasons
        raise ProblemError(Problem("not-ready", str(error), {"reasons": reasons})) from error


# --- calibrations and references


@router.get("/calibrations", responses=problems(*DISK, "unreadable-run"), tags=["calibrations"])
async def calibrations(desk: TheDesk) -> tuple[Calibration, ...]:
    """Calibrations that measurements may use, newest first."""
    return await desk.listing(lambda: tuple(_calibration(item) for item in desk.daemon.calibrations()))


@router.get("/references", responses=problems(*DISK, "unreadable-run"), tags=["calibrations"])
async def references(desk: TheDesk) -> tuple[Calibration, ...]:
    """References that measurements may use, newest first."""
    return await desk.listing(lambda: tuple(_calibration(item) for item in desk.daemon.references()))


@router.post(
    "/calibrations/{run_id}/activate",
    responses=problems(*RUN, *DISK, "not-usable", "invalid"),
    tags=["calibrations"],
)
async def activate_calibration(desk: TheDesk, run_id: str) -> Calibration:
    """Let recipes that say `active` get this calibration."""
    return _calibration(await desk.listing(desk.daemon.activate, run_id, CALIBRATIONS))


@router.post(
    "/references/{run_id}/activate",
    responses=problems(*RUN, *DISK, "not-usable", "invalid"),
    tags=["calibrations"],
)
async def activate_reference(desk: TheDesk, run_id: str) -> Calibration:
    """Let recipes that say `active` get this reference."""
    return _calibration(await desk.listing(desk.daemon.activate, run_id, (REFERENCE,)))


def _calibration(item: LibraryItem) -> Calibration:
    return Calibration(
        id=item.id,
        kind=item.kind,
        name=item.name,
        created=item.created,
        age_days=item.age_days(),
        active=item.active,
        optics=None if item.optics is None else Optics.model_validate(item.optics),
        positions_mm=item.positions_mm,
        uses={str(kind): run_id for kind, run_id in item.uses.items()},
    )
