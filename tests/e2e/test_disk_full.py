"""A disk without room: before a run, and in the middle of one; on a small file system of the test's own."""

import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from irpmd_rig.client import ProblemError
from tests.campaigns.lab import Daemon, Lab
from tests.campaigns.on_disk import complaints, durable_frames, states
from tests.campaigns.recipes import stations
from tests.own_file_system import mounted

pytestmark = pytest.mark.mounts

# A run needs about 230 kB a frame: 60 of them fit, 120 do not.
ROOM_MB = 16
FITS = stations(*range(60), pattern="white")
TOO_MUCH = stations(*range(0, 40, 2))


@pytest.fixture(scope="module")
def running(lab: Lab) -> Iterator[Daemon]:
    """A daemon that alone sees a small file system where its runs go."""
    lab.root.mkdir()
    with lab.daemon(prefix=mounted(lab.root, ROOM_MB)) as daemon:
        yield daemon


@pytest.fixture
def root(lab: Lab, daemon: Daemon) -> Path:
    return lab.seen_by(daemon.pid)


def fill(root: Path) -> Path:
    """Take all the room that is left."""
    path = root / "somebody-else"
    with path.open("wb", buffering=0) as stream, suppress(OSError):
        while stream.write(bytes(4096)):
            pass
    assert shutil.disk_usage(root).free < 4096
    return path


def test_a_run_that_does_not_fit_is_refused_before_it_begins(daemon: Daemon, root: Path) -> None:
    before = sorted(root.iterdir())
    with pytest.raises(ProblemError) as caught:
        daemon.submit(TOO_MUCH)
    assert caught.value.status == 507
    assert "free" in caught.value.detail or "room" in caught.value.detail
    assert sorted(root.iterdir()) == before
    assert daemon.client.queue().waiting == ()


def test_a_disk_that_fills_up_fails_the_run_and_keeps_what_was_written(lab: Lab, daemon: Daemon, root: Path) -> None:
    run_id = daemon.begin(FITS, frames=3)
    filler = fill(root)
    run = daemon.ended(run_id, 60.0)
    assert (run.state, run.reason) == ("failed", "disk_full"), run.detail
    lab.at_rest()
    folder = root / run_id
    assert complaints(folder) == []
    kept = durable_frames(folder)
    assert len(kept) == run.frames >= 3
    assert [found.id for found in daemon.client.runs()] == [run_id]
    with pytest.raises(ProblemError) as caught:
        daemon.submit(stations(0, pattern="white"))
    assert caught.value.status == 507
    filler.unlink()
    run = daemon.retry(run_id)
    assert (run.state, run.attempt, run.frames) == ("succeeded", 2, 60), run.detail
    assert complaints(folder) == []
    assert kept.items() <= durable_frames(folder).items()
    # The transition that found no room was written as soon as there was some.
    assert [state["state"] for state in states(folder)].count("failed") == 1
