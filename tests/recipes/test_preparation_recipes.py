"""Recipes of kind align and characterise: what they say, and what the rig does for them."""

from __future__ import annotations

import pytest

from irpmd_rig.recipes.align import Align
from irpmd_rig.recipes.characterise import CHARACTERISED
from irpmd_rig.recipes.document import DocumentError, parse_document
from irpmd_rig.recipes.plan import Axis, Equipment, Plan, Scene, Shot, check, estimate, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import recipe_file, shipped_recipes

RIG = Equipment(
    stages={"stage1": Axis(-80.0, 220.0, 20.0), "stage2": Axis(0.0, 200.0, 20.0)},
    projector_size_px=(1024, 768),
    pattern_limit=120,
    exposure_range_us=(20.0, 1e6),
    longest_pattern_us=20_000.0,
    subjects=("mirror", "nothing", "step"),
)


def _characterise(what: str, more: str = "") -> str:
    return f"kind: characterise\nname: x\nwhat: {what}\n{more}"


def _planned(text: str) -> Plan:
    return plan(read_recipe(text)[0])


def _told(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_recipe(text, "r")
    return str(caught.value)


def _refused(text: str) -> list[str]:
    recipe, document = read_recipe(text, "r")
    return [str(problem) for problem in check(recipe, plan(recipe), RIG, document)]


@pytest.mark.parametrize("what", CHARACTERISED)
def test_each_what_has_a_model_of_its_own_and_a_shipped_recipe(what: str) -> None:
    assert type(read_recipe(_characterise(what))[0]) is CHARACTERISED[what]
    shipped = [read_recipe(recipe_file(name))[0] for name in shipped_recipes() if name.startswith("characterise-")]
    assert what in {getattr(recipe, "what", None) for recipe in shipped}


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (_characterise("gama"), "'what' must be 'gamma', 'delay', 'settle', 'stage-axis', 'focus' or 'exposure'"),
        ("kind: characterise\nname: x\nfringes: {steps: 24}", "'what' is missing"),
        (_characterise("gamma", "delays_ms: [1, 2, 3]"), "unknown key 'delays_ms'"),
        (_characterise("stage-axis", "object: mirror"), "unknown key 'object'"),
        (_characterise("delay", "delays_ms: [10, 5, 20]"), "'delays_ms[1]' is 5 after 10"),
        (_characterise("settle", "positions_mm: [0]"), "'positions_mm' must be a list of at least 2 items"),
        (_characterise("exposure", "exposures_us: [10, 20]"), "'exposures_us' must be a list of at least 3 items"),
        (_characterise("focus", "counts: [64, 16]"), "'counts[1]' is 16 after 64"),
        ("kind: align\nname: x\ntolerance_deg: 0", "'tolerance_deg' must be at least 0.001"),
        ("kind: align\nname: x\nrounds: 0", "'rounds' must be at least 1"),
        ("kind: reference\nname: x\ncompensation: active", "'compensation' is no id of a run"),
    ],
)
def test_refused(text: str, what: str) -> None:
    assert what in _told(text)


def test_alignment_is_planned_round_by_round_and_each_round_decides() -> None:
    made = _planned("kind: align\nname: x\nrounds: 3")
    assert [station.label for station in made.stations] == ["sprayed", "glass", "mirror", "mirror", "mirror"]
    assert [station.decides for station in made.stations] == [False, False, True, True, True]
    assert made.steered
    prompts = [station.prompt and station.prompt.scene for station in made.stations]
    assert prompts == [Scene("mirror", glass=False), Scene("nothing"), Scene("mirror"), None, None]
    assert isinstance(read_recipe(recipe_file("align"))[0], Align)
    assert not _planned("kind: reference\nname: x").steered


def test_a_settling_stage_is_looked_at_where_it_arrives() -> None:
    made = _planned(_characterise("settle", "positions_mm: [20, 5]\nframes: 30"))
    assert [(station.label, station.stage1_mm, station.frames) for station in made.stations] == [
        ("begin", 20, 12), ("end", 5, 12), ("back", 20, 0), ("settle", 5, 30)
    ]  # fmt: skip
    assert made.stations[-1].shots == (Shot("series", "settle", (64, 63, 56), 4, repeats=30),)


def test_a_delay_is_looked_at_with_white_and_black_beside_it() -> None:
    (station,) = _planned(_characterise("delay", "delays_ms: [0, 10, 20]")).stations
    assert [(shot.role, shot.delay_s) for shot in station.shots] == [
        ("white", 0), ("black", 0), ("switched", 0), ("switched", 0.01), ("switched", 0.02)
    ]  # fmt: skip
    assert [shot.view for shot in station.shots] == [None, None, 0, 1, 2]


def test_exposures_are_those_of_the_stations() -> None:
    made = _planned(_characterise("exposure", "exposures_us: [100, 200, 400]\nobject: step"))
    assert [station.exposure_us for station in made.stations] == [100, 200, 400]
    assert [shot.view for station in made.stations for shot in station.shots] == list(range(6))
    assert made.stations[0].prompt is not None
    assert made.stations[0].prompt.scene == Scene("step")


def test_the_axis_of_the_stage_is_looked_at_with_and_without_mirror_along_both_axes() -> None:
    made = _planned(_characterise("stage-axis", "positions_mm: [0, -40]"))
    assert [(station.label, station.stage1_mm) for station in made.stations] == [
        ("glass", 0), ("glass", -40), ("mirror", 0), ("mirror", -40)
    ]  # fmt: skip
    assert [shot.orientation for shot in made.stations[2].shots] == ["x", "y"]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (_characterise("focus", "counts: [2, 4, 8, 16]\nsteps: 32"), "128 patterns do not fit"),
        (_characterise("gamma", "fringes: {counts: [8, 7], steps: 60}"), "120 patterns do not fit"),
        (_characterise("gamma", "object: stepp"), "did you mean 'step'?"),
        (_characterise("exposure", "exposures_us: [10, 200, 30000]"), "r:4:16: the camera cannot expose for 10 us"),
        (_characterise("exposure", "exposures_us: [100, 200, 30000]"), "shows no pattern for as long as 30000 us"),
    ],
)
def test_what_this_rig_cannot_do_is_told(text: str, what: str) -> None:
    assert what in _refused(text)[0]


def test_frames_and_time_are_estimated() -> None:
    for name in ("align", *(f"characterise-{what}" for what in CHARACTERISED)):
        recipe = read_recipe(recipe_file(name))[0]
        laid_out = plan(recipe)
        takes = estimate(recipe, laid_out, RIG)
        assert takes.frames == sum(shot.frames for station in laid_out.stations for shot in station.shots)
        assert 0 < takes.seconds < 120
        assert check(recipe, laid_out, RIG, parse_document(recipe_file(name))) == ()
