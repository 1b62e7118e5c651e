"""A whole recipe against a rig: what it cannot do, with lines; and what it takes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from irpmd_rig.recipes.plan import Axis, Equipment, Estimate, check, estimate, plan
from irpmd_rig.recipes.reading import read_recipe

_RIG = Equipment(
    stages={"stage1": Axis(-80, 220, 20, 0.2), "stage2": Axis(0, 200, 20, 0.2)},
    camera_size_px=(2048, 2048),
    projector_size_px=(1024, 768),
    exposure_range_us=(20, 1_000_000),
    longest_pattern_us=100_000,
    pattern_limit=120,
    pixel_formats=("Mono8", "Mono10"),
    triggers=("free", "software", "hardware"),
    leds=("red", "green", "blue", "infrared"),
    subjects=("nothing", "mirror", "plate", "board", "board_on_plate", "step"),
    board_poses=30,
)
_MEASURE = "kind: measure\nname: x\nobject: step\n"


def _told(text: str, rig: Equipment = _RIG) -> list[str]:
    recipe, document = read_recipe(text, "r")
    return [str(problem) for problem in check(recipe, plan(recipe), rig, document)]


def _taken(text: str, rig: Equipment = _RIG, **positions_mm: float) -> Estimate:
    recipe, _ = read_recipe(text)
    return estimate(recipe, plan(recipe), rig, positions_mm)


@pytest.mark.parametrize(
    "text",
    [
        _MEASURE,
        "kind: reference\nname: x",
        "kind: calibrate-camera\nname: x",
        "kind: calibrate-plate\nname: x",
        "kind: calibrate-geometry\nname: x",
    ],
)
def test_nothing_is_wrong_on_a_rig_that_can_do_it(text: str) -> None:
    assert _told(text) == []
    # Of a rig that is not known, only its stages are.
    assert _told(text, Equipment(stages=_RIG.stages)) == []


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            _MEASURE + "positions_mm: [-81, 221]",
            [
                "r:4:16: -81 mm is outside the limits of stage1; give -80 to 220 mm",
                "r:4:21: 221 mm is outside the limits of stage1; give -80 to 220 mm",
            ],
        ),
        (_MEASURE + "exposure_us: 10", ["r:4:14: the camera cannot expose for 10 us; give 20 to 1000000, or auto"]),
        (
            _MEASURE + "exposure_us: 200000",
            ["r:4:14: the projector shows no pattern for as long as 200000 us; give at most 100000, or auto"],
        ),
        (
            _MEASURE + "fringes: {counts: [600, 599], orientations: [x, y]}",
            [
                "r:4:19: 600 fringes cannot be shown across 1024 pixels along x; give at most 512",
                "r:4:19: 600 fringes cannot be shown across 768 pixels along y; give at most 384",
            ],
        ),
        (
            _MEASURE + "fringes: {steps: 50}",
            ["r:4:10: 150 patterns do not fit into the projector's memory of 120; give fewer counts or steps"],
        ),
        (
            "kind: measure\nname: x\nobject: stp",
            [
                "r:3:9: the world has no 'stp'; did you mean 'step'? known are: board, board_on_plate, mirror, "
                "nothing, plate, step"
            ],
        ),
        (
            "kind: calibrate-camera\nname: x\nposes: 40\nplate_mm: 300",
            [
                "r:3:8: the world's board has 30 poses beside the one on the plate; give at most 31",
                "r:4:11: 300 mm is outside the limits of stage2; give 0 to 200 mm",
            ],
        ),
        (
            "kind: sequence\nname: x\nsteps:\n- {do: prompt, text: x, subject: board, pose: 30}\n"
            "- {do: set, exposure_us: 1}\n"
            "- {do: move, stage: stage1, position_mm: 400}\n- {do: capture, label: a}\n- {do: capture, label: b}\n"
            "- {do: prompt, text: x, subject: fan}\n- {do: show, pattern: fringes, fringes: {steps: 99}}\n",
            [
                "r:4:47: the world's board has 30 poses; give 0 to 29",
                "r:5:26: the camera cannot expose for 1 us; give 20 to 1000000, or auto",
                "r:6:3: 400 mm is outside the limits of stage1; give -80 to 220 mm",
                "r:9:34: the world has no 'fan'; known are: board, board_on_plate, mirror, nothing, plate, step",
                "r:10:41: 297 patterns do not fit into the projector's memory of 120; give fewer counts or steps",
            ],
        ),
    ],
)
def test_all_that_a_rig_cannot_do_is_told_with_its_line(text: str, told: list[str]) -> None:
    assert _told(text) == told


def test_what_a_rig_does_not_offer() -> None:
    rig = Equipment(
        stages={"stage1": Axis(-80, 220)}, pixel_formats=("Mono8",), triggers=("software",), leds=("green",)
    )
    text = (
        "kind: calibrate-plate\nname: x\npixel_format: Mono10\ntrigger: hardware\n"
        "light: {led: infrared, intensity: 0.5}"
    )
    assert _told(text, rig) == [
        "r:1:1: needs stage2, which this rig does not have; use a rig that has it",
        "r:3:15: Mono10 is none of the camera's pixel formats; did you mean 'Mono8'? known are: Mono8",
        "r:4:10: hardware is none of the camera's triggers; did you mean 'software'? known are: software",
        "r:5:14: infrared is none of the projector's lights; known are: green",
    ]


def test_bytes_frames_and_motion() -> None:
    taken = _taken(_MEASURE, stage1=-60)
    assert taken.frames == 24
    assert 24 * 2048**2 <= taken.bytes < 24.1 * 2048**2
    assert taken.motion_mm == {"stage1": 100}
    assert taken.prompts == 1
    assert _taken(_MEASURE + "pixel_format: Mono10").bytes > 1.99 * taken.bytes
    assert _taken("kind: calibrate-plate\nname: x").motion_mm == {"stage1": 0, "stage2": 200}


def test_time_adds_up() -> None:
    still = _MEASURE + "exposure_us: 30000\ntrigger: hardware\nretries: 0\npositions_mm: [0, 40]"
    # One move of 40 mm, one settling, 24 frames of 30 ms.
    assert _taken(still).seconds == pytest.approx(40 / 20 + 0.2 + 24 * 0.03)
    assert _taken(still, stage1=20.0).seconds == pytest.approx(60 / 20 + 0.4 + 24 * 0.03)
    assert _taken(still + "\nsettle: {time_s: 3}").seconds == pytest.approx(8.92)
    assert _taken(still + "\nsettle: measured").seconds > 3
    assert _taken(still.replace("hardware", "software")).seconds > 2.92 + 24 * 0.05
    assert _taken(still.replace("30000", "auto")).seconds > 2.7
    # The frame rate is the camera's, however short the exposure.
    assert _taken(still.replace("30000", "30")).seconds == pytest.approx(2.2 + 24 * 0.0111)


def test_what_cannot_be_timed_is_told_before_anything_moves() -> None:
    settle = "kind: characterise\nwhat: settle\nname: x\nobject: mirror"
    assert _told(settle) == []
    stages = {"stage1": Axis(-80, 220, 20, 0.2, reads_position=False)}
    (told,) = _told(settle, replace(_RIG, stages=stages))
    assert told.startswith("r:2:7: the controller of stage1 does not say when it arrives")
    delay = "kind: characterise\nwhat: delay\nname: x\nobject: mirror"
    assert _told(delay, replace(_RIG, display_delay_s=0.0)) == []
    (told,) = _told(delay, replace(_RIG, display_delay_s=0.1))
    assert told.startswith("r:2:7: the projector's driver waits 0.1 s")
    assert "display_delay_s: 0 in the rig file" in told
