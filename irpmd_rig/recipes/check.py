"""A whole recipe against a rig, before the first motion."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from irpmd_rig.recipes.characterise import CharacteriseExposure, CharacteriseFocus
from irpmd_rig.recipes.document import Document, Problem, nearest, problem_at
from irpmd_rig.recipes.equipment import Equipment
from irpmd_rig.recipes.estimate import targets
from irpmd_rig.recipes.fields import Fringes
from irpmd_rig.recipes.models import CalibrateCamera, Recipe, Sequence
from irpmd_rig.recipes.stations import Location, Plan
from irpmd_rig.recipes.steps import Ask, Set, Show

Finding = tuple[Location, str, str]


def check(recipe: Recipe, plan: Plan, equipment: Equipment, document: Document) -> tuple[Problem, ...]:
    """Find everything in a recipe that this rig cannot do.

    Parameters
    ----------
    recipe, plan
        The recipe and its plan.
    equipment
        What is known of the rig.
    document
        What the recipe was read from: for lines and columns.

    Returns
    -------
    tuple of Problem
        In the document's order; empty if the rig can do it all.
    """
    findings = (
        *_motion(plan, equipment),
        *_exposures(recipe, equipment),
        *_choices(recipe, equipment),
        *_patterns(recipe, equipment),
        *_scenes(recipe, equipment),
        *_timing(plan, equipment),
    )
    return tuple(sorted({problem_at(document, *finding) for finding in findings}))


def _motion(plan: Plan, equipment: Equipment) -> Iterator[Finding]:
    before: dict[str, float] = {}
    missing: set[str] = set()
    for station in plan.stations:
        for stage, target_mm in targets(station).items():
            axis = equipment.stages.get(stage)
            if axis is None:
                if stage not in missing:
                    yield station.source, f"needs {stage}, which this rig does not have", "use a rig that has it"
                missing.add(stage)
            elif before.get(stage) != target_mm and not axis.lower_mm <= target_mm <= axis.upper_mm:
                what = f"{target_mm:g} mm is outside the limits of {stage}"
                yield station.source, what, f"give {axis.lower_mm:g} to {axis.upper_mm:g} mm"
        before |= targets(station)


def _exposures(recipe: Recipe, equipment: Equipment) -> Iterator[Finding]:
    given: list[tuple[Location, float | str]] = [(("exposure_us",), recipe.exposure_us)]
    if isinstance(recipe, Sequence):
        steps = enumerate(recipe.steps)
        given += [(("steps", k, "exposure_us"), step.exposure_us) for k, step in steps if isinstance(step, Set)]
    if isinstance(recipe, CharacteriseExposure):
        given += [(("exposures_us", k), exposure_us) for k, exposure_us in enumerate(recipe.exposures_us)]
    shortest, longest = equipment.exposure_range_us or (0.0, float("inf"))
    for location, exposure_us in given:
        if isinstance(exposure_us, str):
            continue
        if not shortest <= exposure_us <= longest:
            yield (
                location,
                f"the camera cannot expose for {exposure_us:.10g} us",
                f"give {shortest:.10g} to {longest:.10g}, or auto",
            )
        elif equipment.longest_pattern_us is not None and exposure_us > equipment.longest_pattern_us:
            what = f"the projector shows no pattern for as long as {exposure_us:.10g} us"
            yield location, what, f"give at most {equipment.longest_pattern_us:.10g}, or auto"


def _choices(recipe: Recipe, equipment: Equipment) -> Iterator[Finding]:
    wanted: list[tuple[Location, str | None, tuple[str, ...] | None, str]] = [
        (("pixel_format",), recipe.pixel_format, equipment.pixel_formats, "camera's pixel formats"),
        (("trigger",), recipe.trigger, equipment.triggers, "camera's triggers"),
        (("light", "led"), recipe.light.led if recipe.light else None, equipment.leds, "projector's lights"),
    ]
    for location, choice, offered, whose in wanted:
        if choice is not None and offered is not None and choice not in offered:
            yield location, f"{choice} is none of the {whose}", nearest(choice, offered)


def _patterns(recipe: Recipe, equipment: Equipment) -> Iterator[Finding]:
    if isinstance(recipe, CharacteriseFocus):
        yield from _fitting((), recipe.counts, recipe.steps, ("x",), equipment)
    for location, fringes in _fringes(recipe):
        yield from _fitting(location, fringes.counts, fringes.steps, fringes.orientations, equipment)


def _fitting(
    location: Location, counts: Collection[float], steps: int, orientations: Collection[str], equipment: Equipment
) -> Iterator[Finding]:
    for orientation in orientations:
        size_px = equipment.projector_size_px
        across = None if size_px is None else size_px[0] if orientation == "x" else size_px[1]
        if across is not None and max(counts) > across / 2:
            what = f"{max(counts):g} fringes cannot be shown across {across} pixels along {orientation}"
            yield (*location, "counts"), what, f"give at most {across // 2}"
    patterns = len(counts) * steps
    # A white and a black one are loaded beside them.
    if equipment.pattern_limit is not None and patterns + 2 > equipment.pattern_limit:
        what = f"{patterns} patterns do not fit into the projector's memory of {equipment.pattern_limit}"
        yield location, what, "give fewer counts or steps"


def _fringes(recipe: Recipe) -> Iterator[tuple[Location, Fringes]]:
    if not isinstance(recipe, Sequence):
        fringes = getattr(recipe, "fringes", None)
        if fringes is not None:
            yield ("fringes",), fringes
        return
    for index, step in enumerate(recipe.steps):
        if isinstance(step, Show) and step.pattern == "fringes":
            own = step.fringes is not None
            yield (("steps", index, "fringes") if own else ("fringes",)), step.fringes or recipe.fringes


def _scenes(recipe: Recipe, equipment: Equipment) -> Iterator[Finding]:
    """What an operator who is a program cannot place."""
    subjects, poses = equipment.subjects, equipment.board_poses
    if isinstance(recipe, CalibrateCamera) and poses is not None and recipe.poses - 1 > poses:
        yield (
            ("poses",),
            f"the world's board has {poses} poses beside the one on the plate",
            f"give at most {poses + 1}",
        )
    asked: list[tuple[Location, str]] = []
    if isinstance(recipe, Sequence):
        for index, step in enumerate(recipe.steps):
            if isinstance(step, Ask) and step.subject is not None:
                asked.append((("steps", index, "subject"), step.subject))
                if poses is not None and step.pose >= poses:
                    yield ("steps", index, "pose"), f"the world's board has {poses} poses", f"give 0 to {poses - 1}"
    elif (placed := getattr(recipe, "object", None)) is not None:
        asked.append((("object",), placed))
    for location, subject in asked:
        if subjects is not None and subject not in subjects:
            yield location, f"the world has no {subject!r}", nearest(subject, subjects)


def _timing(plan: Plan, equipment: Equipment) -> Iterator[Finding]:
    """What cannot be timed, since nobody tells when it happens, or the driver itself waits."""
    for station in plan.stations:
        roles = {shot.role for shot in station.shots}
        for name in targets(station) if "series" in roles else ():
            axis = equipment.stages.get(name)
            if axis is not None and not axis.reads_position:
                what = f"the controller of {name} does not say when it arrives, so the time cannot be measured"
                yield ("what",), what, "use a stage whose controller tells its position"
        if "switched" in roles and equipment.display_delay_s:
            waits_s = equipment.display_delay_s
            what = f"the projector's driver waits {waits_s:g} s after each picture, which would be measured, too"
            yield ("what",), what, "set display_delay_s: 0 in the rig file while measuring"
