import logging
import os
import re
import sqlite3
import threading
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from runs_on_disk import QUEUED, RECORD, entry, fail, picture, succeeded

from irpmd_rig.store import (
    DiskFull,
    Library,
    Reason,
    RunInUse,
    RunNotFound,
    RunRecord,
    RunState,
    Store,
    Transition,
    TransitionRefused,
)
from irpmd_rig.store.index import Index


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "runs")


def test_a_new_run_is_there_whole(store: Store) -> None:
    folder = store.create_run(RECORD, Transition(RunState.QUEUED, order=3, key="abc"), "kind: measure  # mine\n")
    assert re.fullmatch(r"\d{8}-\d{6}-[0-9a-f]{6}", folder.id)
    record = folder.record()
    assert (record.id, record.name) == (folder.id, "three facets")
    assert record.versions.keys() >= {"irpmd-rig", "numpy", "python"}
    assert folder.recipe_text() == "kind: measure  # mine\n"
    (run,) = store.runs()
    assert (run.id, run.state, run.order, run.key, run.sample) == (folder.id, RunState.QUEUED, 3, "abc", "S-7")
    assert run.created == record.created


def test_a_run_that_cannot_begin_leaves_nothing(store: Store) -> None:
    with pytest.raises(TransitionRefused):
        store.create_run(RECORD, Transition(RunState.RUNNING))
    assert [path.name for path in store.root.iterdir() if path.is_dir()] == []


@pytest.mark.parametrize(
    "run_id", ["", "..", "../runs", "20260101-000000-abcdef/..", "/etc", "20260101-000000-abcdef\n"]
)
def test_an_id_is_the_servers_own(store: Store, run_id: str) -> None:
    with pytest.raises(RunNotFound):
        store.run(run_id)


def test_a_run_has_one_writer(store: Store) -> None:
    folder = store.create_run(RECORD, QUEUED)
    assert store.run(folder.id) is folder


def test_a_link_is_no_run(store: Store, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (store.root / "20260101-000000-abcdef").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(RunNotFound):
        store.run("20260101-000000-abcdef")
    store.rebuild_index()
    assert store.runs() == ()


def test_runs_are_listed_newest_first_with_their_last_state(store: Store) -> None:
    first = store.create_run(RECORD, QUEUED)
    second = store.create_run(RunRecord(kind="reference"), QUEUED)
    fail(first, Reason.LIMIT)
    listed = {run.id: run for run in store.runs()}
    assert list(listed) == [second.id, first.id]
    assert (listed[first.id].state, listed[first.id].reason) == (RunState.FAILED, Reason.LIMIT)
    assert listed[second.id].kind == "reference"


def test_a_key_finds_its_run_also_after_a_restart(store: Store) -> None:
    folder = store.create_run(RECORD, Transition(RunState.QUEUED, key="abc"))
    fail(folder)
    folder.append_state(Transition(RunState.QUEUED, attempt=2, key="abc"))
    store.close()
    again = Store(store.root).run_by_key("abc")
    assert again is not None
    assert again.id == folder.id
    assert store.run_by_key("abcd") is None


@pytest.mark.parametrize("damage", ["deleted", "garbage", "empty", "old"])
def test_the_index_is_made_again(store: Store, damage: str) -> None:
    fail(store.create_run(RECORD, QUEUED))
    before = store.runs()
    store.close()
    path = store.root / "index.sqlite"
    for leftover in store.root.glob("index.sqlite-*"):
        leftover.unlink()
    path.unlink()
    if damage == "garbage":
        path.write_bytes(os.urandom(5000))
    if damage == "empty":
        path.touch()
    if damage == "old":
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE runs (id TEXT)")
        database.close()
    assert Store(store.root).runs() == before
    assert path.stat().st_size > 0


def test_what_another_process_wrote_is_seen_at_the_next_start(store: Store) -> None:
    first, second = (store.create_run(RECORD, QUEUED) for _ in range(2))
    store.close()
    with (first.path / "state.jsonl").open("a") as file:
        file.write('{"state": "preparing", "time": "2026-11-22T10:00:00Z"}\n')
    for path in second.path.iterdir():
        path.rmdir() if path.is_dir() else path.unlink()
    second.path.rmdir()
    assert [(run.id, run.state) for run in Store(store.root).runs()] == [(first.id, RunState.PREPARING)]


def test_a_damaged_run_is_listed_with_what_is_wrong(store: Store) -> None:
    folder = store.create_run(RECORD, QUEUED)
    (folder.path / "run.yaml").write_text("kind: nothing\n")
    store.rebuild_index()
    (run,) = store.runs()
    assert run.kind == ""
    assert "run.yaml" in run.detail


def test_an_index_that_cannot_be_written_stops_no_run(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    folder = store.create_run(RECORD, QUEUED)
    with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
        patch.setattr(Index, "put", refuse)
        fail(folder, Reason.DISK_FULL)
        assert [run.state for run in store.runs()] == [RunState.FAILED]
    assert "disk is full" in caplog.text
    assert [run.state for run in store.runs()] == [RunState.FAILED]


def test_only_what_has_ended_is_deleted(store: Store) -> None:
    folder = store.create_run(RECORD, QUEUED)
    with pytest.raises(RunInUse, match="abort it first"):
        store.delete(folder.id)
    fail(folder)
    store.delete(folder.id)
    assert not folder.path.exists()
    assert store.runs() == ()
    with pytest.raises(RunNotFound):
        store.delete(folder.id)


def test_what_an_active_reference_was_made_with_is_not_deleted(store: Store) -> None:
    camera = succeeded(store, kind="calibrate-camera")
    plate = succeeded(store, kind="calibrate-plate", uses={"calibrate-camera": camera.id})
    reference = succeeded(store, kind="reference", uses={"calibrate-plate": plate.id})
    Library(store).activate(reference.id)
    for folder in (camera, plate, reference):
        with pytest.raises(RunInUse, match="active"):
            store.delete(folder.id)
    other = succeeded(store, kind="reference")
    Library(store).activate(other.id)
    store.delete(camera.id)


def test_old_measurements_are_deleted_only_as_asked(store: Store) -> None:
    measured, calibrated = succeeded(store), succeeded(store, kind="calibrate-camera")
    waiting = store.create_run(RECORD, QUEUED)
    assert store.delete_older(1) == ()
    later = datetime.now(UTC) + timedelta(days=2)
    assert store.delete_older(1, later) == (measured.id,)
    assert {run.id for run in store.runs()} == {calibrated.id, waiting.id}


def test_what_a_killed_process_left_half_made_is_cleared_away(store: Store) -> None:
    for name in (".new-20260101-000000-abcdef", ".deleted-20260101-000000-abcdef", ".new-20260101-000000-ffffff"):
        (store.root / name / "frames").mkdir(parents=True)
        hour_ago = time.time() - 3600
        os.utime(store.root / name, (hour_ago, hour_ago if "ffffff" not in name else time.time()))
    Store(store.root)
    # The young one may belong to another process that is at work.
    assert [path.name for path in store.root.iterdir() if path.is_dir()] == [".new-20260101-000000-ffffff"]


def test_what_does_not_fit_is_refused_before_it_begins(store: Store) -> None:
    store.check_space(1_000_000)
    with pytest.raises(DiskFull, match=r"MB are free of the .* MB needed") as caught:
        store.check_space(store.free_bytes(), reserve_bytes=10**9)
    assert caught.value.needed_bytes is not None
    assert caught.value.needed_bytes > caught.value.free_bytes


def test_a_store_that_cannot_be_made_is_a_typed_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(Exception, match="cannot write") as caught:
        Store(tmp_path / "file" / "runs")
    assert type(caught.value).__name__ == "WriteFailed"


def test_many_threads_may_use_it(store: Store) -> None:
    errors: list[BaseException] = []

    def work() -> None:
        try:
            folder = store.create_run(RECORD, QUEUED)
            folder.write_frame(picture(0), entry(0))
            folder.close()
            fail(folder)
            assert folder.id in {run.id for run in store.runs()}
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    assert {run.state for run in store.runs()} == {RunState.FAILED}
