"""From a recipe to the plan that the sequencer follows: the paper's procedure, station by station."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Literal

from irpmd_rig.recipes.align import Align
from irpmd_rig.recipes.characterise import Characterised
from irpmd_rig.recipes.check import check
from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.recipes.estimate import Estimate, estimate
from irpmd_rig.recipes.free_sequence import free_stations, shots_of
from irpmd_rig.recipes.models import (
    CalibrateCamera,
    CalibrateGeometry,
    CalibratePlate,
    Measure,
    Recipe,
    Reference,
    Sequence,
)
from irpmd_rig.recipes.placing import REFERENCE_MM, glass_and_mirror, station, uniform
from irpmd_rig.recipes.preparation import alignment, characterisation
from irpmd_rig.recipes.stations import Orientation, Plan, Prompt, Role, Scene, Shot, Station

__all__ = [
    "REFERENCE_MM",
    "Axis",
    "Equipment",
    "Estimate",
    "Orientation",
    "Plan",
    "Prompt",
    "Role",
    "Scene",
    "Shot",
    "Station",
    "check",
    "estimate",
    "plan",
]


def plan(recipe: Recipe) -> Plan:
    """Lay out what a recipe makes the rig do.

    Parameters
    ----------
    recipe
        Of any kind.

    Returns
    -------
    Plan
        Stations numbered from 0. A prompt stands where the scene changes: board, plate, mirror or object to be placed,
        glass to be put in or taken out.
    """
    wait_s = recipe.settle.time_s if recipe.settle is not None and recipe.settle != "measured" else 0.0
    settle: Literal["timed", "measured"] = "measured" if recipe.settle == "measured" else "timed"
    if isinstance(recipe, Sequence):
        return Plan(free_stations(recipe, wait_s, settle))
    stations = (
        replace(
            found,
            index=index,
            exposure_us=recipe.exposure_us if found.exposure_us == "auto" else found.exposure_us,
            wait_s=wait_s,
            settle=settle,
        )
        for index, found in enumerate(_stations(recipe))
    )
    return Plan(tuple(stations))


def _stations(
    recipe: CalibrateCamera | CalibratePlate | CalibrateGeometry | Reference | Measure | Align | Characterised,
) -> Iterable[Station]:
    if isinstance(recipe, CalibrateCamera):
        return _boards(recipe)
    if isinstance(recipe, CalibratePlate):
        return _plates(recipe)
    if isinstance(recipe, CalibrateGeometry):
        return _geometry(recipe)
    if isinstance(recipe, Reference):
        return glass_and_mirror(recipe.fringes, recipe.positions_mm)
    if isinstance(recipe, Measure):
        return _object(recipe)
    if isinstance(recipe, Align):
        return alignment(recipe)
    return characterisation(recipe)


def _boards(recipe: CalibrateCamera) -> Iterator[Station]:
    free = recipe.poses - 1
    for pose in range(free):
        text = (
            f"Take the ground glass out and switch the lamp on; hold the checkerboard in pose {pose + 1} of {free}: "
            f"whole in the picture, tilted, and unlike the poses before."
        )
        scene = Scene("board", pose, glass=False, lamp=True)
        yield station("board", [Shot("plain", "board", view=pose)], Prompt(text, scene))
    text = (
        f"Lay the checkerboard flat on the white plate of stage2, which goes to {recipe.plate_mm:g} mm; no ground "
        f"glass, lamp on."
    )
    scene = Scene("board_on_plate", glass=False, lamp=True)
    last = Shot("plain", "board", view=free)
    yield station("board", [last], Prompt(text, scene), stage2_mm=recipe.plate_mm, source=("plate_mm",))


def _plates(recipe: CalibratePlate) -> Iterator[Station]:
    text = "Put the white plate on stage2, nothing on it; no ground glass, lamp off."
    prompt = Prompt(text, Scene("plate", glass=False))
    for index, position_mm in enumerate(recipe.positions_mm):
        yield station(
            "plate",
            shots_of(recipe.fringes, "plate"),
            prompt if index == 0 else None,
            stage2_mm=position_mm,
            source=("positions_mm", index),
        )


def _geometry(recipe: CalibrateGeometry) -> Iterator[Station]:
    """The sprayed mirror is found without glass, the glass without mirror: each by what then is lit."""
    text = "Put the sprayed mirror on the object support; no ground glass, lamp off."
    prompt = Prompt(text, Scene("mirror", glass=False))
    yield station("sprayed", uniform("sprayed"), prompt, recipe.positions_mm[0], source=("positions_mm", 0))
    yield from glass_and_mirror(recipe.fringes, recipe.positions_mm)


def _object(recipe: Measure) -> Iterator[Station]:
    text = f"Put the object {recipe.object!r} on the object support; ground glass in place, lamp off."
    prompt = Prompt(text, Scene(recipe.object))
    for index, position_mm in enumerate(recipe.positions_mm):
        shots = shots_of(recipe.fringes, "object")
        source = ("positions_mm", index)
        yield station("object", shots, prompt if index == 0 else None, position_mm, source=source)
