"""Peak memory of a measurement: daemon, camera and computing processes together, the simulated world apart."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.acquisition.intake import RecipeText
from irpmd_rig.acquisition.rig_file import RigFile, Storage, read_rig
from irpmd_rig.bench.timing import Row
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.store import RunState

RIG = "sim"
# Enough for a calibration that holds; its accuracy does not matter here.
_CALIBRATION = (
    "{kind: calibrate-camera, name: camera, poses: 10}",
    "{kind: calibrate-plate, name: plate, positions_mm: [0, 25, 50, 75, 100, 125, 150, 175, 200]}",
    "{kind: calibrate-geometry, name: geometry}",
    "{kind: reference, name: reference}",
)
_MEASUREMENT = "{kind: measure, name: mirror step, object: mirror_step_y}"
_TIME_SCALE = 10.0
_LIMIT_S = 600.0
_IDLE_S = 5.0
_SAMPLE_S = 0.02
_MB = 1e6


def run(size_px: int = 2048) -> list[Row]:
    """Measure the peak of the memory above idle, on the simulated rig.

    Parameters
    ----------
    size_px
        Side of the square frames.

    Returns
    -------
    list of Row
        In MB of proportional set size (PSS); the baseline is the same processes at idle, before the first
        measurement.

    Raises
    ------
    MeasurementError
        If a run does not succeed.
    """
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="irpmd-memory-") as folder:
        # In another process: what calibrating leaves behind would pass for idle.
        calibrating = multiprocessing.get_context("spawn").Process(target=_calibrate, args=(folder, size_px))
        calibrating.start()
        calibrating.join()
        if calibrating.exitcode:
            raise MeasurementError("the simulated rig could not be calibrated: see what was said before")
        with RigDaemon(_rig_file(folder, size_px)) as daemon:
            time.sleep(_IDLE_S)
            idle = pss_bytes()
            with _peak() as peak:
                _succeed(daemon, _MEASUREMENT)
    name = f"peak memory of a measurement above idle, {size_px} x {size_px}"
    above, base = (peak[0] - idle) / _MB, idle / _MB
    return [Row(name, above, "MB", "the same processes at idle", base, base / above, "value at most", 600.0, 350.0)]


def pss_bytes() -> int:
    """PSS of this process and all that it started, simulated worlds apart."""
    parents = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(status.parent.name)] = int(status.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    ours, found = {os.getpid()}, 0
    while len(ours) > found:
        found = len(ours)
        ours |= {pid for pid, parent in parents.items() if parent in ours and not _is_world(pid)}
    return sum(_pss_bytes(pid) for pid in ours)


def _is_world(pid: int) -> bool:
    try:
        return b"sims" in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return True


def _pss_bytes(pid: int) -> int:
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


@contextmanager
def _peak() -> Iterator[list[int]]:
    """Give a list whose one element is the largest PSS so far."""
    peak, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(_SAMPLE_S):
            peak[0] = max(peak[0], pss_bytes())

    thread = threading.Thread(target=watch, name="memory", daemon=True)
    thread.start()
    try:
        yield peak
    finally:
        ended.set()
        thread.join()


def _rig_file(root: str, size_px: int) -> RigFile:
    file = read_rig(RIG).with_simulation(private=True, time_scale=_TIME_SCALE, size_px=size_px)
    return replace(file, storage=Storage(root=Path(root)))


def _calibrate(root: str, size_px: int) -> None:
    with RigDaemon(_rig_file(root, size_px)) as daemon:
        for recipe in _CALIBRATION:
            daemon.activate(_succeed(daemon, recipe))


def _succeed(daemon: RigDaemon, recipe: str) -> str:
    """Carry a recipe out; returns the run's id."""
    status, _ = daemon.submit(RecipeText(recipe))
    daemon.queue_action("resume")
    end_s = time.monotonic() + _LIMIT_S
    while status.state is not RunState.SUCCEEDED:
        if status.state is None or status.state.final or time.monotonic() > end_s:
            raise MeasurementError(f"the run {status.name!r} is {status.state}: {status.reason}, {status.detail}")
        time.sleep(0.05)
        status = daemon.run(status.id)
    return status.id
