import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from irpmd_rig.acquisition.conduct import Ending
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.runs import Run, complete_stations, expected_frames, first_incomplete
from irpmd_rig.recipes.equipment import Equipment
from irpmd_rig.recipes.estimate import estimate
from irpmd_rig.recipes.plan import Plan, plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import DiskFull, TransitionRefused
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.states import Reason, RunState, Transition
from irpmd_rig.store.store import Store

RECIPE = """
kind: sequence
name: two stations
fringes: {counts: [8, 7], steps: 3}
steps:
  - {do: move, stage: stage1, position_mm: 0}
  - {do: show, pattern: white}
  - {do: capture, label: near}
  - {do: show, pattern: fringes}
  - {do: capture, label: near}
  - {do: move, stage: stage1, position_mm: 5}
  - {do: capture, label: far}
"""
FAILED = Ending(RunState.FAILED, Reason.DEVICE_LOST, "camera: it is gone")


def frames_of(laid_out: Plan, station: int, attempt: int = 1) -> list[ManifestEntry]:
    return [
        ManifestEntry(
            station=station, label=label, role=role, orientation=orientation, set=number, step=step, view=view,
            attempt=attempt,
        )
        for label, role, orientation, number, step, view in expected_frames(laid_out.stations[station]).elements()
    ]  # fmt: skip


@pytest.fixture
def laid_out() -> Plan:
    return plan(read_recipe(RECIPE)[0])


def test_a_station_is_complete_with_all_its_frames_and_none_too_many(laid_out: Plan) -> None:
    near, far = frames_of(laid_out, 0), frames_of(laid_out, 1)
    assert (len(near), len(far)) == (7, 6)
    assert complete_stations(laid_out, [*near, *far]) == {0, 1}
    assert complete_stations(laid_out, [*near, *far[1:]]) == {0}
    assert complete_stations(laid_out, [*near, near[0], *far]) == {1}
    wrong = near[-1].model_copy(update={"step": 1})
    assert complete_stations(laid_out, [*near[:-1], wrong, *far]) == {1}


def test_a_run_goes_on_at_its_first_incomplete_station(laid_out: Plan) -> None:
    near, far = frames_of(laid_out, 0), frames_of(laid_out, 1)
    assert first_incomplete(laid_out, []) == 0
    assert first_incomplete(laid_out, far) == 0
    assert first_incomplete(laid_out, near) == 1
    assert first_incomplete(laid_out, [*near, *far]) == 2


@pytest.fixture
def events() -> EventLog:
    return EventLog()


@pytest.fixture
def run(tmp_path: Path, events: EventLog, laid_out: Plan) -> Run:
    recipe, _ = read_recipe(RECIPE)
    store = Store(tmp_path)
    folder = store.create_run(
        RunRecord(kind="sequence", name=recipe.name), Transition(RunState.QUEUED, order=7, key="k"), RECIPE
    )
    return Run(folder, recipe, laid_out, estimate(recipe, laid_out, Equipment()), events)


def test_a_state_is_on_disk_before_it_is_told(run: Run, events: EventLog) -> None:
    told = []
    reader = events.subscribe(wake=lambda: told.append(run.folder.state()))
    run.become(RunState.PREPARING)
    assert [state.state for state in told if state is not None] == [RunState.PREPARING]
    assert [event.data["state"] for event in reader.take() or []] == ["preparing"]
    last = run.folder.state()
    assert last is not None
    assert (last.order, last.key, last.attempt) == (7, "k", 1)
    reader.close()


def test_what_the_table_does_not_know_is_refused(run: Run) -> None:
    for state in (RunState.RUNNING, RunState.SUCCEEDED, RunState.PAUSED):
        with pytest.raises(TransitionRefused):
            run.become(state)
    assert run.state is RunState.QUEUED


def test_an_ended_run_can_only_be_opened_again(run: Run) -> None:
    run.become(RunState.PREPARING)
    run.end(FAILED)
    assert (run.status().reason, run.status().detail) == (Reason.DEVICE_LOST, "camera: it is gone")
    with pytest.raises(TransitionRefused):
        run.end(FAILED)
    with pytest.raises(TransitionRefused):
        run.become(RunState.RUNNING)
    conduct = run.conduct
    run.requeue(12)
    assert (run.state, run.attempt, run.order) == (RunState.QUEUED, 2, 12)
    # Wishes for the last attempt are not wishes for this one.
    assert run.conduct is not conduct
    assert run.folder.state().key == "k"  # type: ignore[union-attr]


@contextmanager
def full_disk() -> Iterator[None]:
    """Let no file of this process grow."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_full_disk_does_not_hide_that_a_run_has_ended(run: Run) -> None:
    run.become(RunState.PREPARING)
    with full_disk():
        with pytest.raises(DiskFull):
            run.become(RunState.RUNNING)
        assert run.state is RunState.PREPARING
        run.end(FAILED)
        run.save()
        with pytest.raises(DiskFull):
            run.requeue(8)
    assert run.state is RunState.FAILED
    assert run.folder.state().state is RunState.PREPARING  # type: ignore[union-attr]
    run.save()
    run.save()
    assert [state.state for state in run.folder.states()] == ["queued", "preparing", "failed"]
    run.requeue(9)
    assert run.folder.state().attempt == 2  # type: ignore[union-attr]


def test_progress_and_prompts_are_told(run: Run, events: EventLog) -> None:
    with events.subscribe() as reader:
        run.begin_at(1)
        run.doing("frames")
        run.doing("frames")
        run.frames_done(9)
        run.stations_done(2)
        run.ask(3, "Turn it.", 60.0)
        seen = reader.take() or []
    progress = [event.data for event in seen if event.kind == "progress"]
    assert [(told["frames_done"], told["doing"]) for told in progress] == [
        (7, ""), (7, "frames"), (9, "frames"), (9, "frames")
    ]  # fmt: skip
    assert (progress[-1]["stations_done"], progress[-1]["stations"], progress[-1]["frames"]) == (2, 2, 13)
    assert [event.data["text"] for event in seen if event.kind == "prompt"] == ["Turn it."]
    prompt = run.status().prompt
    assert prompt is not None
    assert (prompt.id, prompt.text) == (3, "Turn it.")
    run.asked_no_more()
    assert run.status().prompt is None


def test_what_is_asked_of_a_run_is_told_until_it_is_obeyed(run: Run) -> None:
    run.become(RunState.PREPARING)
    run.become(RunState.RUNNING)
    run.conduct.pause()
    assert run.status().asked == "pause"
    run.become(RunState.PAUSED)
    assert run.status().asked is None
    run.conduct.end(FAILED)
    assert run.status().asked == "abort"
    run.end(FAILED)
    assert run.status().asked is None
