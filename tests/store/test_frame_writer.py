import threading
import time
from pathlib import Path

import numpy as np
import pytest
from runs_on_disk import entry, new_run, picture
from test_journal import largest_file

from irpmd_rig.store import DiskFull, ManifestEntry, Reason, RunFolder, RunState, Transition, writer
from tests.small_world import until


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return new_run(tmp_path)


def test_a_frame_that_does_not_fit_ends_in_one_typed_error_and_earlier_ones_are_good(folder: RunFolder) -> None:
    with largest_file(50_000):
        for index in range(3):
            folder.write_frame(picture(index), entry(index))
        folder.write_frame(picture(3, size_px=512), entry(3))
        with pytest.raises(DiskFull):
            folder.flush()
        folder.flush()
        folder.append_state(Transition(RunState.FAILED, Reason.DISK_FULL))
    found = folder.reconcile()
    assert (found.frames, found.recovered, found.lost, found.removed, found.unknown) == (3, (), (), (), ())


def test_the_next_frame_after_a_failed_one_raises_and_the_one_after_that_is_written(folder: RunFolder) -> None:
    with largest_file(50_000):
        folder.write_frame(picture(0, size_px=512), entry(0))
        time.sleep(1.0)  # long enough for the writer to have failed
        with pytest.raises(DiskFull):
            folder.write_frame(picture(1), entry(1))
    folder.write_frame(picture(7), entry(7))
    folder.flush()
    assert (folder.manifest()[-1].set, folder.manifest()[-1].step) == (1, 3)


def test_a_manifest_that_does_not_fit_leaves_no_frames_without_lines(folder: RunFolder) -> None:
    folder.write_frame(picture(0, size_px=8), entry(0))
    folder.flush()
    long = {"note": "x" * 50_000}
    # The frame's file fits, its line with the one before does not.
    with largest_file((folder.path / "manifest.jsonl").stat().st_size + 50_200):
        folder.write_frame(picture(1, size_px=8), entry(1, checks=long))
        with pytest.raises(DiskFull):
            folder.flush()
    assert len(list((folder.path / "frames").iterdir())) == 1
    assert len(folder.manifest()) == 1


def test_closing_tells_of_an_error_that_nobody_asked_for(folder: RunFolder) -> None:
    before = set(threading.enumerate())
    with largest_file(50_000):
        folder.write_frame(picture(0, size_px=512), entry(0))
        with pytest.raises(DiskFull):
            folder.close()
    assert not set(threading.enumerate()) - before


def test_the_folder_may_be_used_again_after_closing(folder: RunFolder) -> None:
    for index in range(2):
        folder.write_frame(picture(index), entry(index))
        folder.close()
    assert len(folder.manifest()) == 2


def test_a_slow_disk_holds_the_rig_up_instead_of_filling_the_memory(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, taken = threading.Event(), 0

    def place_slowly(_path: Path, _image: object, frame: ManifestEntry) -> ManifestEntry:
        disk.wait()
        return frame

    def take_frames() -> None:
        nonlocal taken
        for index in range(24):
            folder.write_frame(image, entry(index))
            taken += 1

    monkeypatch.setattr(writer, "place_frame", place_slowly)
    image = np.zeros((2048, 2048), dtype=np.uint8)
    rig = threading.Thread(target=take_frames)
    rig.start()
    # A whole set never waits; more than there is room for does.
    until(lambda: taken >= 12)
    rig.join(0.2)
    assert taken < 24
    disk.set()
    rig.join()
    folder.flush()
    assert len(folder.manifest()) == 24


def test_several_threads_may_write(folder: RunFolder) -> None:
    def write(first: int) -> None:
        for index in range(first, first + 5):
            folder.write_frame(picture(index), entry(index))

    threads = [threading.Thread(target=write, args=(first,)) for first in (0, 12, 24)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    folder.flush()
    entries = folder.manifest()
    assert [frame.index for frame in entries] == list(range(15))
    for frame in entries:
        number = 12 * frame.station + 4 * (frame.set or 0) + (frame.step or 0)
        assert np.array_equal(folder.read_frame(frame), picture(number))
