"""A disk that fills up: files that are refused for want of room, and a small file system of the test's own."""

import errno
import json
import subprocess
import sys
from pathlib import Path

import pytest
from runs_on_disk import entry, new_run, picture

from irpmd_rig.store import DiskFull
from irpmd_rig.store.durable import PART, place_file
from tests.own_file_system import OWN

# Whatever is written there, the kernel answers that there is no room.
FULL = Path("/dev/full")


def test_a_file_for_which_there_is_no_room_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("as before")
    (tmp_path / f"notes.txt{PART}").symlink_to(FULL)
    with pytest.raises(DiskFull, match="no room at"):
        place_file(path, lambda stream: stream.write(b"new" * 10_000))
    assert path.read_text() == "as before"
    assert list(tmp_path.iterdir()) == [path]


def test_frames_for_which_there_is_no_room_are_told_and_the_earlier_ones_stay(tmp_path: Path) -> None:
    known, run = new_run(tmp_path / "known"), new_run(tmp_path / "run")
    for number in range(3):
        known.write_frame(picture(number), entry(number))
    known.flush()
    names = [found.path for found in known.manifest()]
    for number in range(2):
        run.write_frame(picture(number), entry(number))
    run.flush()
    (run.path / f"{names[2]}{PART}").symlink_to(FULL)
    run.write_frame(picture(2), entry(2))
    with pytest.raises(DiskFull, match="no room at"):
        run.flush()
    assert [found.path for found in run.manifest()] == names[:2]
    assert sorted(path.name for path in (run.path / "frames").iterdir()) == [Path(name).name for name in names[:2]]


@pytest.mark.mounts
def test_a_disk_that_fills_up_ends_in_one_typed_error_and_all_earlier_frames_are_good(tmp_path: Path) -> None:
    """On a file system of 2 MB; without the right to mount one, in a name space of its own."""
    script = Path(__file__).with_name("fill_disk.py")
    done = subprocess.run([*OWN, sys.executable, str(script), str(tmp_path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    outcome = json.loads(done.stdout)
    assert 10 < outcome["durable"] < 40
    assert "no room at" in outcome["full"]
    assert outcome["frames"] == outcome["durable"]
    assert outcome["wrong"] == []
    assert outcome["export"] == errno.ENOSPC
    assert outcome["state"] == "failed"
    assert outcome["index"] == ["failed"]
    assert list(tmp_path.iterdir()) == []
