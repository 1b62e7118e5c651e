"""What the memory bench counts: this process and what it started, but no simulated world."""

import subprocess
import sys
from contextlib import contextmanager

import numpy as np

from irpmd_rig.bench.memory import _peak, pss_bytes

_HOLD = "import sys; held = bytearray(b'x') * 60_000_000; print('held', flush=True); sys.stdin.read()"


@contextmanager
def child(*arguments):
    command = [sys.executable, "-c", _HOLD, *arguments]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        yield
        process.stdin.close()


def test_what_a_child_holds_counts_and_what_a_world_holds_does_not():
    idle = pss_bytes()
    assert idle > 5e6
    with child():
        assert pss_bytes() - idle > 50e6
    with child("sims"):
        assert pss_bytes() - idle < 40e6


def test_a_peak_that_has_passed_is_remembered():
    idle = pss_bytes()
    with _peak() as peak:
        for _ in range(3):
            held = np.ones(10_000_000)
            # The watcher looks every 20 ms; looking takes a while where many processes run.
            pss_bytes()
            subprocess.run(["sleep", "0.1"], check=True)
            del held
    assert peak[0] - idle > 60e6
