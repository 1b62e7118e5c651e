"""Plans: the paper's procedure station by station, and free sequences."""

from __future__ import annotations

import pytest

from irpmd_rig.recipes.plan import Plan, Scene, Shot, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import recipe_file


def _shipped(name: str) -> Plan:
    return plan(read_recipe(recipe_file(name))[0])


def _planned(text: str) -> Plan:
    return plan(read_recipe(text)[0])


def _free(*steps: str, more: str = "") -> Plan:
    return _planned(f"kind: sequence\nname: x\n{more}\nsteps:\n" + "".join(f"- {{{step}}}\n" for step in steps))


def _scene(made: Plan, index: int) -> Scene:
    prompt = made.stations[index].prompt
    assert prompt is not None
    assert prompt.scene is not None
    return prompt.scene


@pytest.mark.parametrize(
    ("name", "stations", "frames", "prompts"),
    [
        ("calibrate-camera", 30, 30, 30),
        ("calibrate-plate", 21, 21 * 12, 1),
        ("calibrate-geometry", 9, 2 + 4 * 2 + 4 * 12, 3),
        ("precise-geometry", 9, 2 + 4 * 2 + 4 * 24, 3),
        ("reference", 4, 2 * 2 + 2 * 12, 2),
        ("paper-measure", 2, 2 * 12, 1),
        ("precise-reference", 4, 2 * 2 + 2 * 24, 2),
        ("precise-measure", 2, 2 * 24, 1),
    ],
)
def test_size_of_the_papers_procedure(name: str, stations: int, frames: int, prompts: int) -> None:
    made = _shipped(name)
    assert [station.index for station in made.stations] == list(range(stations))
    assert made.frames == frames
    assert sum(station.prompt is not None for station in made.stations) == prompts
    assert made.needs_operator


def test_boards_are_unlit_views_and_the_last_lies_on_the_plate() -> None:
    made = _shipped("calibrate-camera")
    for index, station in enumerate(made.stations):
        assert station.shots == (Shot("plain", "board", view=index),)
        assert not station.lit
        assert station.stage1_mm == 0
    assert [_scene(made, k) for k in range(29)] == [Scene("board", k, glass=False, lamp=True) for k in range(29)]
    assert all(station.stage2_mm is None for station in made.stations[:-1])
    assert _scene(made, 29) == Scene("board_on_plate", glass=False, lamp=True)
    assert made.stations[29].stage2_mm == 100


def test_plate_is_placed_once_and_goes_through_its_positions() -> None:
    made = _shipped("calibrate-plate")
    assert _scene(made, 0) == Scene("plate", glass=False)
    assert [station.stage2_mm for station in made.stations] == [10.0 * k for k in range(21)]
    assert {station.stage1_mm for station in made.stations} == {0}
    assert {station.shots for station in made.stations} == {(Shot("fringes", "plate", (64, 63, 56), 4),)}
    assert made.stations[7].source == ("positions_mm", 7)


def test_geometry_takes_things_away_and_goes_through_its_positions() -> None:
    made = _shipped("calibrate-geometry")
    uniform, fringes = ("white", "black"), ("fringes",)
    assert [(s.label, s.stage1_mm, tuple(shot.role for shot in s.shots)) for s in made.stations] == [
        ("sprayed", 0, uniform),
        *(("glass", position_mm, uniform) for position_mm in (0, -40, -80, 40)),
        *(("mirror", position_mm, fringes) for position_mm in (0, -40, -80, 40)),
    ]
    assert [_scene(made, k) for k in (0, 1, 5)] == [Scene("mirror", glass=False), Scene("nothing"), Scene("mirror")]
    assert made.stations[7].source == ("positions_mm", 2)


def test_geometry_at_one_position_is_the_papers() -> None:
    made = _planned("{kind: calibrate-geometry, name: x, positions_mm: [10]}")
    assert [(s.label, s.stage1_mm) for s in made.stations] == [("sprayed", 10), ("glass", 10), ("mirror", 10)]


def test_reference_sees_the_glass_then_the_mirror_at_each_position() -> None:
    made = _shipped("precise-reference")
    assert [(station.label, station.stage1_mm) for station in made.stations] == [
        ("glass", -60), ("glass", 40), ("mirror", -60), ("mirror", 40),
    ]  # fmt: skip
    assert (_scene(made, 0), _scene(made, 2)) == (Scene("nothing"), Scene("mirror"))


def test_measurement() -> None:
    made = _shipped("paper-measure")
    assert [station.stage1_mm for station in made.stations] == [0, 40]
    assert _scene(made, 0) == Scene("mirror_step_y")
    assert made.stations[1].prompt is None
    assert made.prompt_in_force(1) == made.stations[0].prompt
    assert all(station.lit and station.exposure_us == "auto" for station in made.stations)


def test_exposure_settling_and_orientations_reach_every_station() -> None:
    text = (
        "kind: measure\nname: x\nobject: o\nexposure_us: 900\nsettle: {time_s: 2}\nfringes: {orientations: [x, y], "
        "steps: 3}"
    )
    made = _planned(text)
    assert made.frames == 2 * 2 * 9
    for station in made.stations:
        assert (station.exposure_us, station.wait_s, station.settle) == (900, 2, "timed")
        assert [shot.orientation for shot in station.shots] == ["x", "y"]
    assert {station.settle for station in _planned("kind: reference\nname: x\nsettle: measured").stations} == {
        "measured"
    }


def test_free_sequence_keeps_its_order() -> None:
    made = _free(
        "do: capture, label: dark",
        "do: show, pattern: white",
        "do: capture, label: bright",
        "do: capture, label: again",
        "do: move, stage: stage1, position_mm: 40",
        "do: move, stage: stage2, position_mm: 10",
        "do: show, pattern: fringes, fringes: {counts: [9, 8], steps: 3}",
        "do: wait, time_s: 2",
        "do: capture, label: fine",
        "do: set, exposure_us: 70",
        "do: show, pattern: fringes",
        "do: capture, label: paper",
        "do: move, stage: stage1, position_mm: 0",
        more="exposure_us: 50\nsettle: {time_s: 1}",
    )
    told = [
        (s.label, s.lit, s.stage1_mm, s.stage2_mm, s.wait_s, s.exposure_us, [shot.label for shot in s.shots])
        for s in made.stations
    ]
    assert told == [
        ("dark", False, None, None, 0, 50, ["dark"]),
        ("bright", True, None, None, 0, 50, ["bright", "again"]),
        ("move", False, 40, None, 1, 50, []),
        ("fine", True, 40, 10, 3, 50, ["fine"]),
        ("paper", True, 40, 10, 0, 70, ["paper"]),
        ("move", False, 0, 10, 1, 70, []),
    ]
    assert made.stations[3].shots == (Shot("fringes", "fine", (9, 8), 3),)
    assert made.frames == 3 + 6 + 12
    assert [station.source[1] for station in made.stations] == [0, 2, 4, 5, 11, 12]


def test_prompts_of_a_free_sequence_begin_a_station() -> None:
    made = _free(
        "do: prompt, text: Clean the glass.",
        "do: prompt, text: Put the plate in., subject: plate, glass: false",
        "do: move, stage: stage2, position_mm: 5",
        "do: capture, label: a",
        "do: prompt, text: Look.",
        "do: capture, label: b",
    )
    prompts = [station.prompt.text if station.prompt else None for station in made.stations]
    assert prompts == ["Clean the glass.", "Put the plate in.", "Look."]
    assert (made.stations[0].shots, made.stations[1].stage2_mm) == ((), 5)
    assert _scene(made, 1) == Scene("plate", glass=False)
    # Going on at the last station needs the plate, not the look.
    assert made.prompt_in_force(2) == made.stations[1].prompt
    assert made.prompt_in_force(0) == made.stations[0].prompt


def test_nothing_is_in_force_without_a_prompt() -> None:
    made = _free("do: capture, label: a")
    assert made.prompt_in_force(0) is None
    assert not made.needs_operator
