import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from runs_on_disk import new_run, picture

from irpmd_rig.store import RunFolder

KILLS = 5


def write_and_kill(folder: RunFolder, first: int, after: int, and_s: float) -> list[str]:
    """Let a process write and kill it a moment after some frames; returns the paths that it was told are durable."""
    script = Path(__file__).with_name("write_until_killed.py")
    command = [sys.executable, str(script), str(folder.path), str(first)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        lines = [process.stdout.readline().rstrip() for _ in range(after)]
        time.sleep(and_s)
        process.send_signal(signal.SIGKILL)
        lines += process.stdout.read().split("\n")[:-1]
    assert process.returncode == -signal.SIGKILL
    return [line.split()[1] for line in lines]


def test_killed_at_any_moment_no_promised_frame_is_lost_or_wrong(tmp_path: Path) -> None:
    moments = random.Random(5)
    folder = new_run(tmp_path)
    promised: list[str] = []
    written = 0
    for _ in range(KILLS):
        promised += write_and_kill(folder, written, moments.randrange(6), moments.uniform(0.0, 0.02))
        folder = RunFolder(folder.path)
        found = folder.reconcile()
        assert (found.lost, found.unknown) == ((), ())
        entries = folder.manifest()
        assert {entry.path for entry in entries} >= set(promised)
        assert {str(path.relative_to(folder.path)) for path in folder.path.glob("frames/*")} == {
            entry.path for entry in entries
        }
        # Frames were numbered on from the last one: its number is the seed of its picture.
        for number, entry in enumerate(entries):
            assert entry.index == number
            assert np.array_equal(folder.read_frame(entry), picture(number))
        written = len(entries)
    assert len(promised) > KILLS
