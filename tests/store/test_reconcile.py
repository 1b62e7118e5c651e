"""What a killed process leaves, made by hand; the kills themselves are in test_killed_writer."""

from pathlib import Path

import numpy as np
import pytest
from runs_on_disk import entry, fail, new_run, picture

from irpmd_rig.store import RunFolder, RunState, Transition


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    folder = new_run(tmp_path)
    for index in range(4):
        folder.write_frame(picture(index), entry(index))
    folder.close()
    return RunFolder(folder.path)


def cut_manifest(folder: RunFolder, nbytes: int) -> None:
    path = folder.path / "manifest.jsonl"
    path.write_bytes(path.read_bytes()[:-nbytes])


def test_nothing_to_do(folder: RunFolder) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.path.rglob("*")}
    found = folder.reconcile()
    assert (found.frames, found.recovered, found.lost, found.removed, found.unknown) == (4, (), (), (), ())
    assert {path: path.stat().st_mtime_ns for path in folder.path.rglob("*")} == before


def test_a_frame_without_its_line_gets_it_again(folder: RunFolder) -> None:
    whole = folder.manifest()
    cut_manifest(folder, 20)
    assert len(folder.manifest()) == 3
    found = folder.reconcile()
    assert found.recovered == (whole[3].path,)
    assert folder.manifest() == whole
    assert np.array_equal(folder.read_frame(folder.manifest()[3]), picture(3))


def test_unfinished_files_are_deleted_and_strangers_stay(folder: RunFolder) -> None:
    (folder.path / "frames" / "00004_x.tif.part").write_bytes(b"half")
    (folder.path / "run.yaml.part").write_text("half")
    (folder.path / "frames" / "notes.txt").write_text("a person's")
    found = folder.reconcile()
    assert set(found.removed) == {"frames/00004_x.tif.part", "run.yaml.part"}
    assert found.unknown == ("frames/notes.txt",)
    assert not list(folder.path.rglob("*.part"))


def test_a_missing_or_damaged_frame_is_taken_out(folder: RunFolder) -> None:
    first, second, *_ = folder.manifest()
    folder.file(first.path).unlink()
    with folder.file(second.path).open("r+b") as file:
        file.seek(-1, 2)
        file.write(b"\0" if picture(1)[-1, -1] else b"\1")
    found = folder.reconcile()
    assert found.lost == (first.path, second.path)
    assert [frame.index for frame in folder.manifest()] == [2, 3]
    assert folder.reconcile().lost == ()


def test_a_frame_that_an_earlier_attempt_left_does_not_come_back(folder: RunFolder) -> None:
    cut_manifest(folder, 20)
    fail(folder)
    folder.append_state(Transition(RunState.QUEUED, attempt=2))
    assert folder.reconcile().recovered
    assert [frame.index for frame in folder.manifest()] == [0, 1, 2]
    folder.write_frame(picture(3), entry(3, attempt=2))
    folder.flush()
    assert [frame.index for frame in folder.manifest()] == [0, 1, 2, 4]


def test_a_torn_state_is_no_state(folder: RunFolder) -> None:
    with (folder.path / "state.jsonl").open("a") as file:
        file.write('{"state": "prepar')
    assert folder.state().state is RunState.QUEUED
    folder.reconcile()
    folder.append_state(Transition(RunState.PREPARING))
    assert [state.state for state in RunFolder(folder.path).states()] == ["queued", "preparing"]
