"""Stations of the routines that prepare a rig: alignment, and what is characterised."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from irpmd_rig.recipes.align import Align
from irpmd_rig.recipes.characterise import (
    Characterised,
    CharacteriseDelay,
    CharacteriseExposure,
    CharacteriseFocus,
    CharacteriseGamma,
    CharacteriseSettle,
    CharacteriseStageAxis,
)
from irpmd_rig.recipes.free_sequence import shots_of
from irpmd_rig.recipes.placing import EMPTY, MIRROR, glass_and_mirror, station, uniform
from irpmd_rig.recipes.stations import Prompt, Scene, Shot, Station


def alignment(recipe: Align) -> Iterator[Station]:
    """Lay out as many rounds as there may be: the frames of each decide whether there is another one.

    Where sprayed mirror and glass are seen is found once, by what is lit without glass and without mirror: turning the
    glass a little moves its picture by less than the rims that are left out.
    """
    text = "Put the sprayed mirror on the object support; no ground glass, lamp off."
    yield station("sprayed", uniform("sprayed"), Prompt(text, Scene("mirror", glass=False)))
    yield station("glass", uniform("glass"), EMPTY)
    for number in range(recipe.rounds):
        found = station("mirror", shots_of(recipe.fringes, "mirror"), MIRROR if number == 0 else None)
        yield replace(found, decides=True)


def characterisation(recipe: Characterised) -> Iterable[Station]:
    """Lay out what is to be characterised."""
    if isinstance(recipe, CharacteriseStageAxis):
        return glass_and_mirror(recipe.fringes, recipe.positions_mm)
    text = f"Put the object {recipe.object!r} on the object support; ground glass in place, lamp off."
    prompt = Prompt(text, Scene(recipe.object))
    if isinstance(recipe, CharacteriseSettle):
        return _settling(recipe, prompt)
    if isinstance(recipe, CharacteriseExposure):
        return _exposures(recipe, prompt)
    return [station(recipe.what, _shots(recipe), prompt)]


def _shots(recipe: CharacteriseGamma | CharacteriseDelay | CharacteriseFocus) -> tuple[Shot, ...]:
    if isinstance(recipe, CharacteriseGamma):
        return shots_of(recipe.fringes, "gamma")
    if isinstance(recipe, CharacteriseFocus):
        return (Shot("fringes", "focus", recipe.counts, recipe.steps),)
    delayed = enumerate(recipe.delays_ms)
    return (*uniform("delay"), *(Shot("switched", "delay", view=k, delay_s=1e-3 * delay) for k, delay in delayed))


def _settling(recipe: CharacteriseSettle, prompt: Prompt) -> Iterator[Station]:
    """Fringes at rest at both places tell how the phase goes with the stage; then it arrives a second time."""
    begin_mm, end_mm = recipe.positions_mm
    for number, label in enumerate(("begin", "end")):
        asked = prompt if number == 0 else None
        place = recipe.positions_mm[number]
        yield station(label, shots_of(recipe.fringes, label)[:1], asked, place, source=("positions_mm", number))
    yield station("back", (), None, begin_mm, source=("positions_mm", 0))
    series = Shot("series", "settle", recipe.fringes.counts, recipe.fringes.steps, repeats=recipe.frames)
    yield station("settle", (series,), None, end_mm, source=("positions_mm", 1))


def _exposures(recipe: CharacteriseExposure, prompt: Prompt) -> Iterator[Station]:
    for number, exposure_us in enumerate(recipe.exposures_us):
        shots = [Shot("white", "exposure", view=2 * number + again) for again in range(2)]
        found = station("exposure", shots, prompt if number == 0 else None, source=("exposures_us", number))
        yield replace(found, exposure_us=exposure_us)
