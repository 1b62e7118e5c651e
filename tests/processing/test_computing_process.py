"""The computing process: faster by what it did ahead, replaced whatever happens to it, and never left behind."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from irpmd_rig.processing import ComputingLost, FramesUnusable, ProcessingError, Worker
from irpmd_rig.store import Reason, RunFolder


@pytest.fixture(scope="module")
def worker(chain):
    worker = Worker(chain.runs.store.root, threads=2)
    yield worker
    worker.close()


@pytest.fixture(scope="module")
def folders(chain, tmp_path_factory):
    """Copies of the runs, without results."""
    root = tmp_path_factory.mktemp("again")
    for kind in ("reference", "measure"):
        shutil.copytree(chain.folders[kind].path, root / kind, ignore=shutil.ignore_patterns("results"))
    return {kind: RunFolder(root / kind) for kind in ("reference", "measure")}


@pytest.fixture
def folder(folders):
    """A run that is computed in no time."""
    folders["reference"].results.clear()
    return folders["reference"]


def gone(pid: int) -> bool:
    """Whether a process has ended; a zombie has."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


def wait_until(true, bound_s: float) -> None:
    end = time.monotonic() + bound_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_it_computes_what_the_program_itself_would(worker, chain, folders):
    told, folder = [], folders["measure"]
    worker.decode(folder.path, 0)
    # What cannot be decoded ahead is no harm.
    worker.decode(folder.path, 99)
    worker.decode(folder.path / "frames", 0)
    done = worker.process(folder.path, told.append)
    ours = chain.processed["measure"]
    assert done.uses == ours.uses
    assert set(done.files) == set(folder.results.names())
    # And the report, with its figures.
    assert done.files[: len(ours.files)] == ours.files
    assert {name.rpartition(".")[2] for name in done.files[len(ours.files) :]} == {"svg", "html"}
    assert done.summary["steps_mm"] == pytest.approx(ours.summary["steps_mm"], abs=1e-9)
    assert told[-1].fraction == 1


def test_what_is_wrong_with_a_run_is_told_and_the_process_goes_on(worker, tmp_path):
    pid = worker.pid
    with pytest.raises(ProcessingError, match=r"run\.yaml") as caught:
        worker.process(tmp_path)
    assert caught.value.reason is Reason.RECONSTRUCTION_FAILED
    (tmp_path / "run.yaml").write_text("kind: measure\n")
    with pytest.raises(FramesUnusable, match=r"has no manifest\.jsonl") as caught:
        worker.process(tmp_path)
    assert caught.value.reason is Reason.FRAME_QUALITY
    assert worker.pid == pid


def test_a_process_that_is_killed_is_replaced_and_the_run_computed(worker, folder):
    pid = worker.pid

    def kill_once(progress):
        if worker.pid == pid and "40 mm" in progress.text:
            os.kill(pid, signal.SIGKILL)

    done = worker.process(folder.path, kill_once)
    assert worker.pid != pid
    assert gone(pid)
    assert set(done.files) == set(folder.results.names())


def test_a_process_that_dies_again_fails_the_run_and_the_next_run_works(worker, folder):
    def kill(progress):
        if "40 mm" in progress.text:
            os.kill(worker.pid, signal.SIGKILL)

    with pytest.raises(ComputingLost, match=r"ended 2 times \(signal SIGKILL\)") as caught:
        worker.process(folder.path, kill)
    assert caught.value.reason is Reason.RECONSTRUCTION_FAILED
    assert worker.process(folder.path).files


def test_a_process_that_hangs_is_replaced(worker, folder):
    pid, usual = worker.pid, worker.silence_s
    worker.silence_s = 0.5
    os.kill(pid, signal.SIGSTOP)
    started = time.monotonic()
    with pytest.raises(ComputingLost, match=r"told nothing for 0\.5 s and was replaced"):
        worker.process(folder.path)
    assert time.monotonic() - started < 60
    assert gone(pid)
    worker.silence_s = usual
    assert worker.process(folder.path).files


def test_computing_can_be_cancelled(worker, folder):
    pid = worker.pid

    def cancel(progress):
        if "40 mm" in progress.text:
            threading.Thread(target=worker.cancel).start()

    with pytest.raises(ProcessingError, match="cancelled") as caught:
        worker.process(folder.path, cancel)
    assert caught.value.reason is Reason.ABORTED_BY_USER
    assert gone(pid)
    assert folder.results.names() == ()
    worker.cancel()


def test_half_of_the_results_of_a_killed_process_are_none(worker, folders):
    folder, pid = folders["measure"], worker.pid

    def kill(progress):
        if progress.file == "depth_mm.npy":
            os.kill(worker.pid, signal.SIGKILL)

    with pytest.raises(ComputingLost):
        worker.process(folder.path, kill)
    assert gone(pid)
    assert folder.results.names() == ()


def test_who_is_told_can_end_it_by_an_error(chain, folder):
    worker = Worker(chain.runs.store.root, threads=2)
    pid = worker.pid

    def refuse(_):
        raise InterruptedError

    try:
        with pytest.raises(InterruptedError):
            worker.process(folder.path, refuse)
        assert gone(pid)
    finally:
        worker.close()


def test_a_closed_worker_is_gone_and_says_so(chain, folder):
    worker = Worker(chain.runs.store.root)
    pid = worker.pid
    worker.close()
    worker.close()
    assert gone(pid)
    worker.decode(folder.path, 0)
    with pytest.raises(ComputingLost, match="closed"):
        worker.process(folder.path)


def test_it_ends_with_its_parent_in_the_middle_of_its_work(chain, folder):
    program = (
        "import sys; from pathlib import Path; from irpmd_rig.processing import Worker\n"
        "worker = Worker(Path(sys.argv[1]))\n"
        "tell = lambda progress: print(worker.pid, progress.text, flush=True)\n"
        "while True: worker.process(Path(sys.argv[2]), tell)\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", program, str(chain.runs.store.root), str(folder.path)],
        stdout=subprocess.PIPE,
        text=True,
    )
    with parent:
        lines = iter(parent.stdout.readline, "")
        pid = next(int(line.split()[0]) for line in lines if "40 mm" in line)
        assert not gone(pid)
        parent.kill()
    wait_until(lambda: gone(pid), 30.0)
