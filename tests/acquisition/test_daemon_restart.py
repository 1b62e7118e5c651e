"""A daemon that is killed, or ends, in the middle of a run."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_world import OWNER, at_rest, began, ended, stations

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Reason, RunState
from tests.small_world import rig_file, until
from tests.small_world import world as served

PLACES_MM = tuple(range(0, 60, 3))
PROGRAM = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from daemon_world import stations
from irpmd_rig.acquisition.daemon import RigDaemon
from tests.small_world import rig_file
daemon = RigDaemon(rig_file(Path(sys.argv[1]), Path(sys.argv[2])))
daemon.start()
status, _ = daemon.submit(stations(*PLACES_MM, pattern="fringes"), "the key")
later, _ = daemon.submit(stations(1))
daemon.queue_action("resume")
print(status.id, later.id, flush=True)
sys.stdin.read()
""".replace("PLACES_MM", repr(PLACES_MM))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    with served(tmp_path_factory.mktemp("world")) as world:
        yield world


def children(pid: int) -> list[int]:
    found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(line) for line in found.stdout.split()]


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"


def killed_daemon(world: WorldControl, root: Path, wait_s: float) -> tuple[str, str]:
    """Kill a daemon in the middle of a run, and return the ids of that run and of the one behind it."""
    command = [sys.executable, "-c", PROGRAM, str(world.folder), str(root), str(Path(__file__).parent)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        run_id, later_id = process.stdout.readline().split()
        manifest = root / run_id / "manifest.jsonl"
        until(lambda: manifest.stat().st_size > 0)
        time.sleep(wait_s)
        helpers = children(process.pid)
        assert len(helpers) >= 2
        process.send_signal(signal.SIGKILL)
        process.wait(60)
    # The camera's and the computing process never outlive it.
    until(lambda: not any(exists(pid) for pid in helpers))
    return run_id, later_id


def test_a_killed_daemon_loses_no_frame_and_nothing_resumes_by_itself(world: WorldControl, tmp_path: Path) -> None:
    run_id, later_id = killed_daemon(world, tmp_path, random.Random(5).uniform(0.0, 0.5))
    durable = {entry.path for entry in RunFolder(tmp_path / run_id).manifest()}
    assert durable
    with RigDaemon(rig_file(world.folder, tmp_path)) as daemon:
        at_rest(world)
        status = daemon.run(run_id)
        assert (status.state, status.reason, status.attempt) == (RunState.INTERRUPTED, Reason.DAEMON_RESTARTED, 1)
        folder = daemon.store.run(run_id)
        good = folder.manifest()
        assert durable <= {entry.path for entry in good}
        assert all(folder.read_frame(entry).shape == (96, 96) for entry in good)
        assert sorted(entry.path for entry in good) == sorted(
            f"frames/{path.name}" for path in (folder.path / "frames").iterdir()
        )
        queue = daemon.queue_status()
        assert queue.held
        assert run_id in queue.why
        assert queue.waiting == (later_id,)
        time.sleep(0.6)
        assert daemon.run(later_id).state is RunState.QUEUED
        # A client that asks again for what it had submitted gets that run.
        assert daemon.submit(stations(*PLACES_MM, pattern="fringes"), "the key")[0].id == run_id
        lease = daemon.take_lease(OWNER, 60).id
        daemon.act(run_id, "retry", lease)
        assert daemon.queue_status().waiting == (later_id, run_id)
        daemon.release_lease(lease)
        daemon.queue_action("resume")
        status = ended(daemon, run_id)
        assert (status.state, status.attempt, status.frames) == (RunState.SUCCEEDED, 2, 6 * len(PLACES_MM))
        # The axes were homed again: nothing of the first attempt is mixed in, but its files stay.
        assert {entry.attempt for entry in daemon.store.run(run_id).manifest()} == {2}
        assert all((folder.path / path).is_file() for path in durable)


def test_a_daemon_that_is_closed_interrupts_its_run_and_leaves_the_rig_at_rest(
    world: WorldControl, tmp_path: Path
) -> None:
    daemon = RigDaemon(rig_file(world.folder, tmp_path))
    daemon.start()
    run_id = began(daemon, stations(*PLACES_MM))
    until(lambda: (daemon.run(run_id).frames or 0) >= 2)
    before = children(os.getpid())
    began_s = time.monotonic()
    daemon.close()
    assert time.monotonic() - began_s < 60.0
    at_rest(world)
    last = RunFolder(tmp_path / run_id).state()
    assert last is not None
    assert (last.state, last.reason) == (RunState.INTERRUPTED, Reason.DAEMON_RESTARTED)
    assert len(children(os.getpid())) <= len(before) - 2
    daemon.close()
    # The same store can be used again at once.
    with RigDaemon(rig_file(world.folder, tmp_path)) as again:
        assert again.run(run_id).state is RunState.INTERRUPTED
