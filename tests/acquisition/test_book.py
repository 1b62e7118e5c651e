"""Runs taken in, found again by a later daemon, opened again; no instruments."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpmd_rig.acquisition.book import ActionRefused, RecipeRefused, RunBook
from irpmd_rig.acquisition.conduct import Ending
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.intake import Intake, RecipeText, named_recipe
from irpmd_rig.acquisition.queue import RunQueue
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.acquisition.steering import Wish, steer
from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import RunFolderError, RunNotFound
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.states import Reason, RunState, Transition
from irpmd_rig.store.store import Store

EQUIPMENT = Equipment(stages={"stage1": Axis(-80, 220), "stage2": Axis(0, 200)}, camera_size_px=(64, 64))
SIM = read_rig("sim")
FILE = replace(SIM, storage=SIM.storage.model_copy(update={"reserve_gb": 0.0}))
RECIPE = RecipeText("kind: sequence\nname: one frame\nsteps:\n  - {do: capture, label: dark}\n")
ABORT = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, "Ada")


class Life:
    """A book as one daemon has it."""

    def __init__(self, root: Path) -> None:
        self.store = Store(root)
        self.queue = RunQueue()
        self.events = EventLog()
        intake = Intake(lambda: FILE, lambda: EQUIPMENT, dict, self.store)
        self.book = RunBook(self.store, self.queue, self.events, intake)
        self.interrupted = self.book.recover()

    def submit(self, key: str | None = None, recipe: RecipeText = RECIPE) -> str:
        return self.book.submit(recipe, FILE, key)[0].id


def test_the_queue_is_the_same_after_a_restart(tmp_path: Path) -> None:
    life = Life(tmp_path)
    ids = [life.submit() for _ in range(3)]
    life.queue.remove(ids[0])
    life.book.live(ids[0]).end(ABORT)
    life.book.retry(ids[0])
    assert life.queue.waiting() == (ids[1], ids[2], ids[0])
    again = Life(tmp_path)
    assert again.interrupted == ()
    assert again.queue.waiting() == (ids[1], ids[2], ids[0])
    assert again.queue.why_held
    # Places are never given twice.
    assert again.queue.next_order() > max(again.book.live(run_id).order or 0 for run_id in ids)
    assert again.book.known(ids[1]) is not None


@pytest.mark.parametrize(
    "path",
    [
        (RunState.PREPARING,),
        (RunState.PREPARING, RunState.RUNNING),
        (RunState.PREPARING, RunState.RUNNING, RunState.PAUSED),
        (RunState.PREPARING, RunState.RUNNING, RunState.WAITING_FOR_OPERATOR),
        (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING),
    ],
    ids=lambda path: path[-1].value,
)
def test_whatever_was_under_way_is_interrupted_and_can_be_retried(tmp_path: Path, path: tuple[RunState, ...]) -> None:
    life = Life(tmp_path)
    run_id = life.submit("its key")
    run = life.book.live(run_id)
    for state in path:
        run.become(state)
    run.folder.write_frame(np.zeros((4, 4), np.uint8), ManifestEntry(label="dark", role="plain"))
    run.folder.flush()
    # Written, but killed before its line was.
    manifest = tmp_path / run_id / "manifest.jsonl"
    manifest.write_bytes(manifest.read_bytes()[:-9])
    del run, life
    again = Life(tmp_path)
    assert again.interrupted == (run_id,)
    status = again.book.status(run_id)
    assert (status.state, status.reason, status.frames) == (RunState.INTERRUPTED, Reason.DAEMON_RESTARTED, 1)
    assert path[-1].value in status.detail
    assert again.queue.waiting() == ()
    assert Life(tmp_path).interrupted == ()
    assert again.book.retry(run_id).attempt == 2
    assert again.submit("its key") == run_id


def test_a_damaged_folder_hides_nothing_else(tmp_path: Path) -> None:
    life = Life(tmp_path)
    bad, good = life.submit(), life.submit()
    (tmp_path / bad / "state.jsonl").write_text("no state\n" * 2)
    del life
    again = Life(tmp_path)
    assert again.queue.waiting() == (good,)
    listed = {status.id: status.state for status in again.book.statuses()}
    assert listed == {bad: None, good: RunState.QUEUED}
    with pytest.raises(RunFolderError):
        again.book.live(bad)


def test_a_folder_that_cannot_be_changed_keeps_no_daemon_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    life = Life(tmp_path)
    bad, good = life.submit(), life.submit()
    life.book.live(bad).become(RunState.PREPARING)
    del life

    def refuse(_: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr("irpmd_rig.acquisition.book.withdraw_partial", refuse)
    again = Life(tmp_path)
    assert again.interrupted == ()
    assert again.queue.waiting() == (good,)


def test_a_folder_written_by_hand_is_listed_and_not_run(tmp_path: Path) -> None:
    life = Life(tmp_path)
    run_id = "20260101-000000-abcdef"
    (tmp_path / run_id).mkdir()
    (tmp_path / run_id / "run.yaml").write_text("kind: measure\nname: by hand\n")
    status = life.book.status(run_id)
    assert (status.kind, status.name, status.state) == ("measure", "by hand", None)
    with pytest.raises(RunFolderError, match="not made by the daemon"):
        life.book.retry(run_id)
    with pytest.raises(ActionRefused):
        steer(life.book, life.queue, None, Wish(run_id, "abort", "Ada"))


def test_only_what_ended_badly_is_retried(tmp_path: Path) -> None:
    life = Life(tmp_path)
    run_id = life.submit()
    with pytest.raises(ActionRefused, match="queued"):
        life.book.retry(run_id)
    run = life.book.live(run_id)
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED):
        run.become(state)
    life.book.forget(run_id)
    with pytest.raises(ActionRefused, match="succeeded"):
        life.book.retry(run_id)
    with pytest.raises(RunNotFound):
        life.book.retry("20260101-000000-000000")


def test_a_recipe_that_the_rig_cannot_do_makes_no_run(tmp_path: Path) -> None:
    life = Life(tmp_path)
    far = RecipeText(
        "kind: sequence\nname: far\nsteps:\n  - {do: move, stage: stage2, position_mm: 500}\n"
        "  - {do: capture, label: far}\n"
    )
    with pytest.raises(RecipeRefused, match="outside the limits of stage2"):
        life.submit(recipe=far)
    assert life.book.statuses() == ()
    assert life.submit(recipe=named_recipe("paper-measure"))


def test_the_recipe_is_kept_as_it_was_given(tmp_path: Path) -> None:
    life = Life(tmp_path)
    text = "# why\n" + RECIPE.text
    run_id = life.submit(recipe=RecipeText(text))
    assert life.store.run(run_id).recipe_text() == text
    record: RunRecord = life.store.run(run_id).record()
    assert record.recipe["name"] == "one frame"
    first: Transition | None = life.store.run(run_id).state()
    assert first is not None
    assert first.state is RunState.QUEUED
