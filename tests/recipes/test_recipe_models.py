"""What recipes may say: every kind, its defaults, and each field that is refused."""

from __future__ import annotations

import re
from itertools import chain

import pytest

from irpmd_rig.recipes import base, characterise, fields, models, steps
from irpmd_rig.recipes.document import DocumentError, Settings
from irpmd_rig.recipes.models import KINDS, CalibratePlate, Measure
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import recipe_file, shipped_recipes

_LEAST = {
    "calibrate-camera": "",
    "calibrate-plate": "",
    "calibrate-geometry": "",
    "reference": "",
    "measure": "object: step\n",
    "sequence": "steps: [{do: capture, label: a}]\n",
    "align": "",
    "characterise": "what: gamma\n",
}


def _told(text: str) -> str:
    with pytest.raises(DocumentError) as caught:
        read_recipe(text, "r")
    return str(caught.value)


def _least(kind: str) -> str:
    return f"kind: {kind}\nname: x\n{_LEAST[kind]}"


@pytest.mark.parametrize("kind", KINDS)
def test_least_recipe_of_each_kind(kind: str) -> None:
    recipe, document = read_recipe(_least(kind))
    assert isinstance(recipe, KINDS[kind])
    assert document.text == _least(kind)
    assert (recipe.exposure_us, recipe.pixel_format, recipe.retries) == ("auto", "Mono8", 2)
    assert (recipe.light, recipe.trigger, recipe.settle, recipe.nominal_steps_mm) == (None, None, None, ())
    # A recipe written into a run's folder can be read again.
    assert type(recipe).model_validate_json(recipe.model_dump_json()) == recipe


def test_defaults_are_the_papers() -> None:
    measure, plate = read_recipe(_least("measure"))[0], read_recipe(_least("calibrate-plate"))[0]
    assert isinstance(measure, Measure)
    assert isinstance(plate, CalibratePlate)
    assert measure.fringes.counts == (64, 63, 56)
    assert (measure.fringes.steps, measure.fringes.orientations) == (4, ("x",))
    assert measure.positions_mm == (0, 40)
    assert (measure.method, measure.compare, measure.if_calibration_is_off) == ("auto", (), "refuse")
    assert plate.positions_mm == tuple(range(0, 201, 10))


def test_every_common_field() -> None:
    recipe, _ = read_recipe(
        "kind: measure\nname: Step 7\nobject: step\noperator: Ada\nsample: S-12\nnotes: |\n  one\n  two\n"
        "nominal_steps_mm: [3.9, 7]\nlight: {led: red, intensity: 0.25}\nexposure_us: 8000\npixel_format: Mono10\n"
        "trigger: software\nsettle: {time_s: 1.5}\nretries: 0\ncalibration: 20260102-030405-0a1b2c\n"
        "reference: active\nmethod: depth-equation\npositions_mm: [-60, 40]\n"
        "fringes: {counts: [64, 63, 56], steps: 8, orientations: [x, y]}\n"
    )
    assert isinstance(recipe, Measure)
    assert recipe.notes == "one\ntwo\n"
    assert recipe.light == fields.Light(led="red", intensity=0.25)
    assert recipe.settle == fields.Settle(time_s=1.5)
    assert (recipe.calibration, recipe.reference) == ("20260102-030405-0a1b2c", "active")
    assert read_recipe(_least("measure") + "settle: measured")[0].settle == "measured"


@pytest.mark.parametrize(
    ("kind", "line", "what"),
    [
        ("measure", "exposure_us: 0", "'exposure_us' must be above 0"),
        ("measure", "exposure_us: -5", "'exposure_us' must be above 0"),
        ("measure", "exposure_us: 1e8", "must be at most 10000000"),
        ("measure", "exposure_us: automatic", "must be a number or 'auto'"),
        ("measure", "light: {led: infrared, intensity: 0.61}", "'light.intensity' must be at most 0.6"),
        ("measure", "light: {led: infrared, intensity: 0}", "'light.intensity' must be above 0"),
        ("measure", "light: {led: ir, intensity: 0.5}", "must be 'infrared', 'red', 'green' or 'blue'"),
        ("measure", "light: {led: infrared}", "'light.intensity' is missing"),
        ("measure", "settle: {time_s: -1}", "'settle.time_s' must be at least 0"),
        ("measure", "settle: {time_s: 1, time: 1}", "unknown key 'settle.time'; did you mean 'time_s'?"),
        ("measure", "settle: 1", "'settle' must be a mapping or 'measured', not 1"),
        ("measure", "retries: 11", "'retries' must be at most 10"),
        ("measure", "retries: 1.0", "'retries' must be a whole number, not 1.0"),
        ("measure", "pixel_format: Mono12", "must be 'Mono8' or 'Mono10', not 'Mono12'"),
        ("measure", "nominal_steps_mm: 4", "must be a list, not 4"),
        ("measure", "operator: ' x'", "'operator' has line ends, or blanks at its ends"),
        ("measure", "positions_mm: [0]", "must be a list of at least 2 items"),
        ("measure", "positions_mm: [0, 0]", "'positions_mm[1]' is 0 mm, the same place as the first position"),
        ("measure", "positions_mm: [0, 0.05]", "at least 0.1 mm apart"),
        (
            "measure",
            "positions_mm: [0, 20, 40]\nmethod: depth-equation",
            "'positions_mm[2]' has 3 positions; the depth equation takes two",
        ),
        ("measure", "compare: [facets, facets]", "'compare' names a method twice"),
        ("measure", "compare: [auto]", "must be 'depth-equation', 'generalised', 'triangulation' or 'facets'"),
        ("measure", "max_chi2: 1", "'max_chi2' must be above 1"),
        ("measure", "if_calibration_is_off: ignore", "must be 'refuse' or 'mark', not 'ignore'"),
        ("calibrate-geometry", "positions_mm: []", "must be a list of at least 1 item"),
        ("calibrate-geometry", "positions_mm: [0, 0.01]", "at least 0.1 mm apart"),
        ("measure", "positions_mm: [0, 4000]", "'positions_mm[1]' must be at most 1000"),
        ("measure", "method: magic", "'method' must be 'auto', 'depth-equation', 'generalised', 'triangulation'"),
        ("measure", "reference: ../../etc", "'reference' is neither 'active' nor the id of a run"),
        ("measure", "calibration: 20260102-030405-0a1b2c\\n", "neither 'active' nor"),
        ("measure", "fringes: {counts: [64, 62, 56]}", "'fringes.counts' cannot be unwrapped"),
        ("measure", "fringes: {counts: [64, 64, 56]}", "must differ from each other"),
        ("measure", "fringes: {counts: [64.5, 63.5]}", "needs whole fringe counts"),
        ("measure", "fringes: {counts: [0, 1]}", "'fringes.counts[0]' must be above 0"),
        ("measure", "fringes: {counts: [64]}", "must be a list of at least 2 items"),
        ("measure", "fringes: {steps: 2}", "'fringes.steps' must be at least 3"),
        ("measure", "fringes: {steps: 4.0}", "write a whole number without a decimal point"),
        ("measure", "fringes: {steps: four}", "must be a whole number, not 'four'"),
        ("measure", "fringes: {orientations: [y]}", "must be [x] or [x, y]"),
        ("measure", "fringes: {orientations: [x, x]}", "must be [x] or [x, y]"),
        ("measure", "fringes: {orientations: [z]}", "must be 'x' or 'y', not 'z'"),
        ("measure", "glass: true", "unknown key 'glass'"),
        ("reference", "object: x", "unknown key 'object'"),
        ("calibrate-camera", "poses: 2", "'poses' must be at least 3"),
        ("calibrate-camera", "fringes: {}", "unknown key 'fringes'"),
        ("calibrate-plate", "positions_mm: [0, 10, 20]", "must be a list of at least 4 items"),
        (
            "calibrate-plate",
            "positions_mm: [0, 10, 20, 10]",
            "'positions_mm[3]' is 10 mm, the same place as the second",
        ),
    ],
)
def test_refused_field(kind: str, line: str, what: str) -> None:
    told = _told(_least(kind) + line)
    assert told.count("\n") == 0
    assert what in told
    assert told.startswith(f"r:{_least(kind).count(chr(10)) + 1}:")


@pytest.mark.parametrize(
    ("step", "what"),
    [
        ("{do: mve, stage: stage1}", "'steps[1].do' is unknown: 'mve'; did you mean 'move'?"),
        ("{stage: stage1}", "'steps[1].do' is missing"),
        ("{do: move, stage: stage3, position_mm: 1}", "must be 'stage1' or 'stage2', not 'stage3'"),
        ("{do: move, stage: stage1, position: 1}", "did you mean 'position_mm'?"),
        ("{do: wait, time_s: -1}", "'steps[1].time_s' must be at least 0"),
        ("{do: capture, label: Über/..}", "'steps[1].label' is no label"),
        ("{do: show, pattern: grey}", "must be 'fringes', 'white', 'black' or 'plain'"),
        ("{do: show, pattern: white, fringes: {steps: 4}}", "'steps[1].fringes' are given, but the pattern is white"),
        ("{do: show, pattern: fringes, fringes: {steps: 1}}", "'steps[1].fringes.steps' must be at least 3"),
        ("{do: prompt, text: ''}", "'steps[1].text' must be text with at least 1 character"),
        ("{do: prompt, text: x, lamp: true}", "'steps[1].lamp' is given without a subject"),
        ("{do: prompt, text: x, subject: mirror, pose: 3}", "'steps[1].pose' is for the board only"),
        ("{do: set, exposure_us: 0}", "'steps[1].exposure_us' must be above 0"),
        ("{do: set}", "'steps[1].exposure_us' is missing"),
        ("capture", "'steps[1]' must be a mapping"),
    ],
)
def test_refused_step(step: str, what: str) -> None:
    told = _told(f"kind: sequence\nname: x\nsteps:\n- {{do: capture, label: a}}\n- {step}\n")
    assert what in told
    assert all(line.startswith("r:5:") for line in told.splitlines())


def test_sequence_needs_a_capture() -> None:
    assert "'steps' has no capture" in _told("kind: sequence\nname: x\nsteps: [{do: wait, time_s: 1}]")
    assert "'steps' must be a list of at least 1 item" in _told("kind: sequence\nname: x\nsteps: []")


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        ("measur", "there is no kind 'measur'; did you mean 'measure'?"),
        ("[measure]", "'kind' must be text"),
        ("", "'kind' is missing; add kind: calibrate-camera"),
        ("*x", "anchors and aliases"),
    ],
)
def test_unknown_kind_is_told_with_what_else_is_wrong(kind: str, what: str) -> None:
    told = _told(f"kind: {kind}\nname: 3\nretries: -1").splitlines()
    assert what in told[0]
    assert told[1].startswith("r:2:7: 'name' must be text")
    assert told[2].startswith("r:3:10: 'retries' must be at least 0")
    assert len(told) == 3


def test_shipped_recipes_are_found_by_name_and_cover_every_kind() -> None:
    read = {name: read_recipe(recipe_file(name))[0] for name in shipped_recipes()}
    assert {recipe.kind for recipe in read.values()} == set(KINDS)
    assert recipe_file("paper-measure.yaml") == shipped_recipes()["paper-measure"]
    for first, second in (("reference", "paper-measure"), ("precise-reference", "precise-measure")):
        assert read[first].positions_mm == read[second].positions_mm  # type: ignore[union-attr]
        assert read[first].fringes == read[second].fringes  # type: ignore[union-attr]
    assert read["precise-geometry"].fringes == read["precise-measure"].fringes  # type: ignore[union-attr]
    assert (read["paper-measure"].method, read["precise-measure"].method) == ("depth-equation", "facets")  # type: ignore[union-attr]
    with pytest.raises(FileNotFoundError, match="paper-measure"):
        recipe_file("nothing-of-this-name")


def test_every_field_is_documented() -> None:
    classes = {
        thing
        for thing in chain(*(vars(module).values() for module in (base, characterise, models, fields, steps)))
        if isinstance(thing, type) and issubclass(thing, Settings) and thing is not Settings
    }
    assert len(classes) > 12
    for kind in classes:
        own = set(kind.model_fields) - {key for base in kind.__bases__ for key in getattr(base, "model_fields", ())}
        told = re.findall(r"^    (\w+(?:, \w+)*) : ", kind.__doc__ or "", re.MULTILINE)
        assert own == {name for names in told for name in names.split(", ")}, kind
