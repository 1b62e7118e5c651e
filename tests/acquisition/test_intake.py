from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.protocols import (
    DeviceLost,
    LimitReached,
    NotConnected,
    Position,
    Refused,
    StageCondition,
    StageState,
    TimedOut,
    TravelLimits,
)
from irpmd_rig.acquisition.intake import Intake, NoSuchRecipe, RecipeText, named_recipe
from irpmd_rig.acquisition.interlocks import (
    axes_of,
    check_move,
    check_start,
    equipment_of,
    instruments_of,
    record_of,
    rig_part,
    rig_reasons,
)
from irpmd_rig.acquisition.rig import DeviceCondition, DeviceState, Rig
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.processing.rig_facts import rig_facts
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.recipes.plan import plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.shipped import shipped_recipes
from irpmd_rig.store.errors import DiskFull
from irpmd_rig.store.store import Store

EQUIPMENT = Equipment(
    stages={"stage1": Axis(-80, 220, 20.0, 0.2), "stage2": Axis(0, 200, 20.0, 0.2)}, camera_size_px=(64, 64)
)
FILE = read_rig("sim")


def intake(folder: Path, reserve_gb: float = 0.0) -> Intake:
    file = replace(FILE, storage=FILE.storage.model_copy(update={"reserve_gb": reserve_gb}))
    return Intake(lambda: file, lambda: EQUIPMENT, lambda: {"stage1": -60.0}, Store(folder))


@pytest.mark.parametrize("name", sorted(shipped_recipes()))
def test_every_shipped_recipe_is_valid_on_the_simulated_rig(tmp_path: Path, name: str) -> None:
    validation = intake(tmp_path).validate(named_recipe(name))
    assert validation.ok, validation.problems
    assert validation.estimate is not None
    assert validation.estimate.frames > 0
    assert validation.stations[0].startswith("0 ")


def test_a_name_is_no_path() -> None:
    for name in ("nothing", "../worlds/ideal", str(shipped_recipes()["reference"])):
        with pytest.raises(NoSuchRecipe):
            named_recipe(name)


def test_all_problems_of_all_stages_are_told_with_their_places(tmp_path: Path) -> None:
    text = "kind: measure\nname: x\nobject: y\npositions_mm: [0, 900]\nexposure_us: 5000.0\n"
    validation = intake(tmp_path).validate(RecipeText(text, "mine.yaml"))
    assert [str(problem).split(";")[0] for problem in validation.problems] == [
        "mine.yaml:4:19: 900 mm is outside the limits of stage1"
    ]
    unreadable = intake(tmp_path).validate(RecipeText("kind: measure\nobjekt: y\n"))
    assert unreadable.kind is None
    assert len(unreadable.problems) >= 2
    with pytest.raises(DocumentError):
        intake(tmp_path).read(RecipeText("[]"))


def test_what_may_change_until_a_run_begins_is_a_warning(tmp_path: Path) -> None:
    validation = intake(tmp_path, reserve_gb=1e6).validate(named_recipe("paper-measure"))
    assert validation.ok
    assert any("no calibrate-geometry is active" in warning for warning in validation.warnings)
    assert any("no room" in warning for warning in validation.warnings)


def test_the_disk_has_to_hold_all_that_waits(tmp_path: Path) -> None:
    made = intake(tmp_path)
    takes = made.read(named_recipe("paper-measure")).estimate
    free = Store(tmp_path).free_bytes()
    made.check_space(takes)
    with pytest.raises(DiskFull, match="no room"):
        made.check_space(*[takes] * (2 + free // made.bytes_needed(takes)))


# --- interlocks


def test_a_plan_needs_only_what_it_uses() -> None:
    measure = plan(read_recipe(named_recipe("paper-measure").text)[0])
    plates = plan(read_recipe(named_recipe("calibrate-plate").text)[0])
    assert axes_of(measure) == {"stage1"}
    assert instruments_of(plates) == {"camera", "projector", "stage1", "stage2"}


def test_the_record_says_what_the_computing_needs(tmp_path: Path) -> None:
    order = intake(tmp_path).read(named_recipe("paper-measure"))
    record = record_of(order.recipe, FILE)
    assert record.kind == "measure"
    assert record.positions_mm == (0.0, 40.0)
    assert record.uses == {"calibrate-geometry": "active", "reference": "active"}
    assert record.fringes is not None
    assert (record.fringes.counts, record.fringes.steps) == ((64.0, 63.0, 56.0), 4)
    assert record.nominal_steps_mm == (3.9868, 7.0248, 5.0062, 6.0986)
    assert rig_facts(record).stage1.in_position_mm == 0.01
    assert rig_part(FILE)["world"].endswith("misaligned.yaml")


def rig_with(stage: Any, devices: dict[str, DeviceState] | None = None, operator: Any = None) -> Any:
    return SimpleNamespace(stage=lambda _: stage, stages={"stage1": stage}, devices=devices or {}, operator=operator)


def no_position() -> Position:
    raise Refused("stage1", "it has no zero", "home it")


def mute() -> Position:
    raise TimedOut("stage1", "no answer", "look")


def stage(condition: StageCondition, target_mm: float | None = None, *, can_home: bool = True) -> Any:
    return SimpleNamespace(
        limits=lambda: TravelLimits(0.0, 100.0),
        state=lambda: StageState(
            condition, None if condition is StageCondition.NO_ZERO else Position(0.0, measured=True), target_mm, 1.0
        ),
        capabilities=lambda: SimpleNamespace(can_home=can_home),
        position=no_position,
    )


def test_a_move_is_refused_outside_the_limits_without_zero_or_while_moving_elsewhere() -> None:
    check_move(rig_with(stage(StageCondition.READY)), "stage1", 100.0)
    check_move(rig_with(stage(StageCondition.MOVING, 50.0)), "stage1", 50.0)
    for target_mm in (-0.1, 100.1, float("nan")):
        with pytest.raises(LimitReached, match="give 0 to 100 mm"):
            check_move(rig_with(stage(StageCondition.READY)), "stage1", target_mm)
    with pytest.raises(Refused, match="no zero"):
        check_move(rig_with(stage(StageCondition.NO_ZERO)), "stage1", 5.0)
    silent = stage(StageCondition.NO_ZERO)
    silent.position = mute
    with pytest.raises(TimedOut):
        check_move(rig_with(silent), "stage1", 5.0)
    with pytest.raises(Refused, match="still moves to 7"):
        check_move(rig_with(stage(StageCondition.MOVING, 7.0)), "stage1", 5.0)


def test_a_missing_instrument_is_told_by_its_own_error_where_it_is_needed() -> None:
    measure = plan(read_recipe(named_recipe("paper-measure").text)[0])
    gone = DeviceState(
        "stage", "serial", DeviceCondition.LOST, "its line went away", "plug it in", DeviceLost("stage1", "x", "y")
    )
    ready = DeviceState("stage", "serial", DeviceCondition.READY)
    devices = {"camera": ready, "projector": ready, "stage1": gone, "stage2": ready}
    rig = rig_with(stage(StageCondition.READY), devices)
    rig.instrument = lambda _: None
    with pytest.raises(DeviceLost, match="its line went away"):
        check_start(rig, measure)
    reasons = rig_reasons(rig, instruments_of(measure), [])
    assert reasons == ["stage1 is lost: its line went away (plug it in)"]
    rig.devices = {**devices, "stage1": ready, "stage2": gone}
    check_start(rig, measure)
    assert rig_reasons(rig, instruments_of(measure), []) == []


def test_a_zero_is_a_persons_business_only_where_no_program_can_give_it() -> None:
    axes = ["stage1"]
    needed = frozenset({"stage1"})
    assert rig_reasons(rig_with(stage(StageCondition.NO_ZERO)), needed, axes) == []
    blind = stage(StageCondition.NO_ZERO, can_home=False)
    assert rig_reasons(rig_with(blind, operator=object()), needed, axes) == []
    (reason,) = rig_reasons(rig_with(blind), needed, axes)
    assert reason == "stage1 has no zero and cannot home: zero it at a known place"
    assert rig_reasons(rig_with(blind), frozenset({"stage2"}), axes) == []


def test_a_rig_that_is_not_open_is_checked_by_its_file() -> None:
    equipment = equipment_of(Rig(FILE))
    assert set(equipment.stages) == {"stage1", "stage2"}
    assert equipment.stages["stage1"].speed_mm_per_s == 20.0
    assert equipment.camera_size_px is None
    with pytest.raises(NotConnected):
        check_start(Rig(FILE), plan(read_recipe(named_recipe("paper-measure").text)[0]))
