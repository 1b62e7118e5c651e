import json
import random
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import tifffile
from runs_on_disk import QUEUED, entry, fail, new_run, picture

from irpmd_rig.store import (
    FileNotInRun,
    Optics,
    Reason,
    RunFolder,
    RunFolderError,
    RunState,
    Transition,
    TransitionRefused,
)


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return new_run(tmp_path)


def write(folder: RunFolder, *indices: int) -> None:
    for index in indices:
        folder.write_frame(picture(index), entry(index))
    folder.flush()


def test_a_person_can_read_it(folder: RunFolder) -> None:
    write(folder, 0, 13)
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "frames",
        "manifest.jsonl",
        "run.yaml",
        "state.jsonl",
    ]
    assert "name: three facets" in (folder.path / "run.yaml").read_text()
    assert [path.name for path in sorted((folder.path / "frames").iterdir())] == [
        "00000_station0_object_fringes_set0_step0.tif",
        "00001_station1_object_fringes_set0_step1.tif",
    ]
    lines = [json.loads(line) for line in (folder.path / "manifest.jsonl").read_text().splitlines()]
    assert [line["stage1_mm"] for line in lines] == [0.0, 40.0]


def test_frames_come_back_as_they_were(folder: RunFolder) -> None:
    deep = np.arange(64 * 48, dtype=np.uint16).reshape(64, 48)
    folder.write_frame(picture(0), entry(0))
    given = folder.write_frame(deep, entry(1, bits=10, label="mirror"))
    folder.flush()
    first, second = folder.manifest()
    assert np.array_equal(folder.read_frame(first), picture(0))
    assert np.array_equal(folder.read_frame(second), deep)
    assert (given.index, given.path) == (1, second.path)
    assert (second.bits, second.counts, second.steps) == (10, (64, 63, 56), 4)


def test_a_frame_says_itself_how_it_was_taken(folder: RunFolder) -> None:
    write(folder, 5)
    with tifffile.TiffFile(folder.file(folder.manifest()[0].path)) as file:
        described = json.loads(file.pages.first.description)
        assert file.pages.first.compression == 1
    assert (described["set"], described["step"]) == (1, 1)


def test_frames_of_a_station_a_label_or_a_role(folder: RunFolder) -> None:
    write(folder, 0, 1, 12)
    folder.write_frame(picture(3), entry(0, label="glass", role="white", set=None, step=None))
    folder.flush()
    assert [frame.index for frame in folder.frames(station=0)] == [0, 1, 3]
    assert [frame.index for frame in folder.frames(label="glass")] == [3]
    assert [frame.index for frame in folder.frames(station=1, role="fringes")] == [2]


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros((4, 4, 3), np.uint8), np.zeros((0, 4), np.uint8)])
def test_what_is_no_frame_is_refused(folder: RunFolder, image: np.ndarray) -> None:
    with pytest.raises(RunFolderError, match="a frame is"):
        folder.write_frame(image, entry(0))


def test_superseded_frames_do_not_count_and_stay_on_disk(folder: RunFolder) -> None:
    write(folder, 0, 1)
    folder.supersede(folder.frames(station=0))
    write(folder, 0)
    assert [frame.index for frame in folder.manifest()] == [2]
    assert len(list((folder.path / "frames").iterdir())) == 3


def test_a_number_is_never_given_twice(folder: RunFolder) -> None:
    write(folder, 0, 1)
    folder.supersede(folder.manifest())
    folder.close()
    again = RunFolder(folder.path)
    write(again, 0)
    assert [frame.index for frame in again.manifest()] == [2]


def test_states_are_entered_by_the_table(folder: RunFolder) -> None:
    folder.append_state(Transition(RunState.PREPARING))
    with pytest.raises(TransitionRefused):
        folder.append_state(Transition(RunState.SUCCEEDED))
    fail(folder)
    folder.append_state(Transition(RunState.QUEUED, attempt=2, order=7, key="k"))
    states = RunFolder(folder.path).states()
    assert [state.state for state in states] == ["queued", "preparing", "failed", "queued"]
    assert states[2].reason is Reason.FRAMES_LOST
    assert (states[3].attempt, states[3].order, states[3].key) == (2, 7, "k")
    assert states[0].time == QUEUED.time


def test_a_wrong_state_is_named(folder: RunFolder) -> None:
    with (folder.path / "state.jsonl").open("a") as file:
        file.write('{"state": "dreaming"}\n')
    with pytest.raises(RunFolderError, match=r"state.jsonl:2: .*state"):
        folder.state()


def test_what_becomes_known_later_is_entered(folder: RunFolder) -> None:
    optics = Optics(camera_serial="42", size_px=(64, 48))
    assert folder.record().optics is None
    folder.amend(optics=optics, uses={"reference": "20260102-030405-00ff00"})
    assert RunFolder(folder.path).record().optics == optics
    assert folder.record().name == "three facets"
    with pytest.raises(RunFolderError, match="optics"):
        folder.amend(optics={"camera_serial": "42"})


def test_all_that_is_wrong_in_a_record_is_said_at_once(folder: RunFolder) -> None:
    (folder.path / "run.yaml").write_text("kind: measurement\nfringes: {counts: [0], steps: 4}\nsampel: 3\n")
    with pytest.raises(RunFolderError, match=r"kind.*fringes.*sampel"):
        folder.record()


@pytest.mark.parametrize("content", ["kind: measure\nkind: reference\n", "[", "", "- 1", "a: &x [*x]", "\0"])
def test_a_broken_record_is_a_typed_error(folder: RunFolder, content: str) -> None:
    (folder.path / "run.yaml").write_text(content)
    with pytest.raises(RunFolderError, match=r"run\.yaml"):
        folder.record()


def test_a_number_or_a_date_may_be_a_name(folder: RunFolder) -> None:
    (folder.path / "run.yaml").write_text("kind: measure\nsample: 17\noperator:\nname: 2026-11-22\n")
    record = folder.record()
    assert (record.sample, record.operator, record.name) == ("17", "", "2026-11-22")


@pytest.mark.parametrize(
    "name", ["../other", "/etc/passwd", "frames/link.tif", "link/x", "frames", "", "a\0b", "a" * 5000]
)
def test_no_path_leaves_the_folder(folder: RunFolder, tmp_path: Path, name: str) -> None:
    (tmp_path / "other").write_text("x")
    (tmp_path / "x").write_text("x")
    (folder.path / "frames" / "link.tif").symlink_to(tmp_path / "other")
    (folder.path / "link").symlink_to(tmp_path)
    with pytest.raises(FileNotInRun):
        folder.file(name)


def test_a_manifest_that_points_elsewhere_is_refused(folder: RunFolder, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "secret.tif", picture(0))
    (folder.path / "manifest.jsonl").write_text('{"path": "../secret.tif"}\n')
    with pytest.raises(RunFolderError, match="not a file of"):
        folder.read_frame(folder.manifest()[0])


@pytest.mark.parametrize("line", ['{"set": 1}', '{"path": "a", "sett": 1}', '{"path": "a", "stage1_mm": NaN}'])
def test_a_wrong_line_of_the_manifest_is_named(folder: RunFolder, line: str) -> None:
    (folder.path / "manifest.jsonl").write_text(line + '\n{"path": "b"}\n')
    with pytest.raises(RunFolderError, match=r"manifest\.jsonl:1: "):
        folder.manifest()


def test_what_is_no_picture_is_a_typed_error(folder: RunFolder) -> None:
    write(folder, 0)
    frame = folder.manifest()[0]
    folder.file(frame.path).write_bytes(b"II*\0")
    with pytest.raises(RunFolderError, match="not a frame"):
        folder.read_frame(frame)


def test_nothing_is_left_running(folder: RunFolder) -> None:
    before = set(threading.enumerate())
    with folder:
        write(folder, 0)
    assert not set(threading.enumerate()) - before


def test_any_damage_to_a_frame_is_a_typed_error_or_another_picture(folder: RunFolder) -> None:
    chance = random.Random(1)
    write(folder, 0)
    frame = folder.manifest()[0]
    path = folder.file(frame.path)
    whole = path.read_bytes()
    for _ in range(200):
        content = bytearray(whole[: chance.choice([10, 200, 1000, None])])
        for _ in range(chance.randrange(1, 8)):
            content[chance.randrange(min(len(content), 400))] = chance.randrange(256)
        path.write_bytes(content)
        with suppress(RunFolderError):
            assert folder.read_frame(frame).ndim == 2
    assert folder.reconcile().lost == (frame.path,)
