"""A recipe that names a run which cannot serve is refused when it is submitted, not when it begins."""

from pathlib import Path

import pytest

from irpmd_rig.acquisition.intake import Intake, RecipeText
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.store.record import Kind, RunRecord
from irpmd_rig.store.states import Reason, RunState, Transition
from irpmd_rig.store.store import Store

FILE = read_rig("sim")
EQUIPMENT = Equipment(
    stages={"stage1": Axis(-80, 220, 20.0, 0.2), "stage2": Axis(0, 200, 20.0, 0.2)}, camera_size_px=(64, 64)
)
MEASURE = "kind: measure\nname: x\nobject: y\ncalibration: {}\nreference: {}\n"
TO_SUCCESS = (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


def made(store: Store, kind: Kind, *states: RunState, reason: Reason | None = None) -> str:
    folder = store.create_run(RunRecord(kind=kind), Transition(RunState.QUEUED, order=1))
    for state in states:
        folder.append_state(Transition(state, reason if state.final and state is not RunState.SUCCEEDED else None))
    return folder.id


def problems(store: Store, calibration: str, reference: str) -> list[str]:
    intake = Intake(lambda: FILE, lambda: EQUIPMENT, dict, store)
    return [str(problem) for problem in intake.read(RecipeText(MEASURE.format(calibration, reference))).problems]


def test_what_was_never_made_or_is_of_another_kind_is_told_with_its_place(store: Store) -> None:
    camera = made(store, "calibrate-camera", *TO_SUCCESS)
    unknown, wrong = problems(store, camera, "20260101-000000-abcdef")
    assert unknown.startswith(f"recipe:4:14: run {camera} is a calibrate-camera, not a calibrate-geometry")
    assert wrong.startswith("recipe:5:12: there is no run '20260101-000000-abcdef'")
    assert problems(store, "active", "20260101-000000-abcdef") == [wrong]


def test_what_ended_badly_cannot_serve(store: Store) -> None:
    failed = made(store, "reference", RunState.PREPARING, RunState.FAILED, reason=Reason.LIMIT)
    (told,) = problems(store, "active", failed)
    assert "has not succeeded: it is failed" in told


def test_what_waits_or_is_under_way_may_serve_when_its_turn_has_come(store: Store) -> None:
    assert problems(store, made(store, "calibrate-geometry"), "active") == []
    assert problems(store, "active", made(store, "reference", *TO_SUCCESS[:3])) == []


def test_what_has_no_results_cannot_serve(store: Store) -> None:
    geometry, reference = (made(store, kind, *TO_SUCCESS) for kind in ("calibrate-geometry", "reference"))
    told = problems(store, geometry, reference)
    assert told
    assert geometry in told[0]


def test_a_compensation_that_cannot_serve_is_told_and_one_that_waits_may(store: Store) -> None:
    intake = Intake(lambda: FILE, lambda: EQUIPMENT, dict, store)

    def told(run_id: str) -> list[str]:
        text = f"kind: reference\nname: x\ncalibration: active\ncompensation: {run_id}\n"
        return [str(problem) for problem in intake.read(RecipeText(text)).problems]

    assert told(made(store, "characterise")) == []
    (unknown,) = told("20260101-000000-abcdef")
    assert unknown.startswith("recipe:4:15: compensation 20260101-000000-abcdef cannot be used")
    (without_table,) = told(made(store, "characterise", *TO_SUCCESS))
    assert "cannot be used" in without_table
