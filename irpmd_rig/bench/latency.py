"""Time from the last frame on disk to the depth map on disk, in the computing process as a daemon uses it."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from irpmd_rig.bench.measurement import POSITIONS_MM, SteppedMirror, calibrated, measured
from irpmd_rig.bench.timing import Row
from irpmd_rig.processing import Progress, Worker
from irpmd_rig.recipes.models import Method
from irpmd_rig.store import RunFolder, Store

_DEPTH = "depth_mm.npy"
_THREADS = 2
# Bits of a pixel, and the method where it is not the default one.
_KINDS: tuple[tuple[int, Method | None], ...] = ((8, None), (10, None), (8, "depth-equation"))
# While the stage moves, the first position is decoded; nothing else is measured then.
_MOVE_S = 2.0


def run(size_px: int = 2048, repeats: int = 3) -> list[Row]:
    """Measure the time to the depth map by the default method, for frames of 8 and of 10 bits.

    Parameters
    ----------
    size_px
        Side of the square frames.
    repeats
        Measurements of each kind.

    Returns
    -------
    list of Row
        In ms, the first position decoded, and the stage's position found from its glass, ahead while the stage moved;
        the baseline is the same measurement with nothing done ahead. And the same by the depth equation.

    Raises
    ------
    ProcessingError
        If it cannot be computed.
    """
    rows = []
    for bits, method in _KINDS:
        with tempfile.TemporaryDirectory(prefix="irpmd-latency-") as folder:
            store = Store(Path(folder))
            mirror = SteppedMirror(size_px, bits)
            calibrated(store, mirror)
            measurement = measured(store, mirror, method)
            worker = Worker(store.root, threads=_THREADS)
            try:
                worker.process(measurement.path)
                times = [_times(worker, measurement) for _ in range(repeats)]
            finally:
                worker.close()
                store.close()
        ahead, without = (statistics.median(pair[k] for pair in times) for k in (0, 1))
        must, aim = (300.0, 100.0) if (bits, method) == _KINDS[0] else (None, None)
        name = f"last frame on disk to depth map on disk, {bits} bits" + (f", by {method}" if method else "")
        rows.append(Row(name, ahead, "ms", "nothing done ahead", without, without / ahead, "value at most", must, aim))
    return rows


def _times(worker: Worker, folder: RunFolder) -> tuple[float, float]:
    """Milliseconds to the depth map with and without decoding ahead."""
    for station in range(len(POSITIONS_MM) - 1):
        worker.decode(folder.path, station)
    time.sleep(_MOVE_S)
    return _time_ms(worker, folder), _time_ms(worker, folder)


def _time_ms(worker: Worker, folder: RunFolder) -> float:
    there: list[float] = []

    def note(progress: Progress) -> None:
        if progress.file == _DEPTH:
            there.append(time.perf_counter())

    start = time.perf_counter()
    worker.process(folder.path, note)
    return 1e3 * (there[0] - start)
