"""Time of an acquisition cycle: two fringe measurements and a move between them, on the replayed world."""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from drivers.settings import checked
from drivers.stage.axis import SerialStageSettings
from irpmd_rig.acquisition.capture import FringeFrames, Photographer
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.bench.timing import Row
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.store import Fringes, ManifestEntry, RunFolder, RunRecord, RunState, Store, Transition

RIG = "sim"
COUNTS, STEPS = (64.0, 63.0, 56.0), 4
FRAMES = 2 * len(COUNTS) * STEPS
POSITIONS_MM = (0.0, 40.0)
STAGE = "stage1"
RAMP_S = 0.2
"""The controller's acceleration time, which its driver sets: it lengthens a move by as much."""


@dataclass(frozen=True, slots=True)
class Cycle:
    """Seconds from its beginning until its last frame was in memory, and until all frames were durable."""

    in_memory_s: float
    durable_s: float


def run(size_px: int = 2048, cycles: int = 5) -> list[Row]:
    """Measure acquisition cycles at the instruments' true pace, triggered by hardware.

    Parameters
    ----------
    size_px
        Side of the square frames.
    cycles
        How many are timed, after a rehearsal that renders the frames.

    Returns
    -------
    list of Row
        'acquisition cycle', whose ``ratio`` is the *difference* in ms to the physical minimum: 24 of the camera's
        shortest periods, the move at the stage's speed and ramp, and its settle time. 'all durable' is for
        information.

    Raises
    ------
    MeasurementError
        An instrument of the simulated rig is not there.
    """
    rig_file = read_rig(RIG).with_simulation(private=True, replay=True, time_scale=1.0, size_px=size_px)
    with Rig(rig_file) as rig, tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        missing = [f"{name}: {state.detail}" for name, state in rig.devices.items() if state.error is not None]
        if missing:
            raise MeasurementError("; ".join(missing))
        photographer = Photographer(rig, "hardware")
        photographer.expose("white")
        with _run_folder(Path(folder)) as run_folder:
            timed = [_cycle(photographer, run_folder) for _ in range(cycles + 1)][1:]
        minimum_s = _physical_minimum_s(rig)
    return _rows(timed, minimum_s)


def _rows(timed: list[Cycle], minimum_s: float) -> list[Row]:
    in_memory_ms = 1e3 * statistics.median(cycle.in_memory_s for cycle in timed)
    durable_ms = 1e3 * statistics.median(cycle.durable_s for cycle in timed)
    minimum_ms = 1e3 * minimum_s
    baseline = f"{FRAMES} camera periods, move, settle; ratio: ms beyond it"
    return [
        Row(
            "acquisition cycle", in_memory_ms, "ms", baseline, minimum_ms, in_memory_ms - minimum_ms,
            "at most", 300.0, 60.0,
        ),
        Row(
            "acquisition cycle, all durable", durable_ms, "ms", baseline, minimum_ms, durable_ms - minimum_ms,
            "at most", None, None,
        ),
    ]  # fmt: skip


def _cycle(photographer: Photographer, folder: RunFolder) -> Cycle:
    """One cycle, as a measurement goes; the way back is not timed."""
    photographer.move(STAGE, POSITIONS_MM[0])
    photographer.prepare_fringes(COUNTS, STEPS)
    began_s = time.perf_counter()
    first = photographer.take_fringes(COUNTS, STEPS)
    photographer.begin_move(STAGE, POSITIONS_MM[1])
    # The stage takes longer than all this.
    photographer.prepare_fringes(COUNTS, STEPS)
    _keep(folder, photographer.check(first))
    photographer.move(STAGE, POSITIONS_MM[1])
    second = photographer.take_fringes(COUNTS, STEPS)
    in_memory_s = time.perf_counter() - began_s
    _keep(folder, photographer.check(second))
    return Cycle(in_memory_s, time.perf_counter() - began_s)


def _keep(folder: RunFolder, frames: FringeFrames) -> None:
    for captured in frames:
        entry = ManifestEntry(set=captured.set, step=captured.step, exposure_us=captured.exposure_us)
        folder.write_frame(captured.frame.image, entry)
    folder.flush()


def _run_folder(root: Path) -> RunFolder:
    record = RunRecord(kind="measure", fringes=Fringes(counts=COUNTS, steps=STEPS))
    return Store(root).create_run(record, Transition(state=RunState.QUEUED))


def _physical_minimum_s(rig: Rig) -> float:
    rates_hz = rig.camera.capabilities().frame_rate_range_hz
    assert rates_hz is not None
    stage = checked(SerialStageSettings, rig.file.devices[STAGE].settings, device=STAGE)
    distance_mm = abs(POSITIONS_MM[1] - POSITIONS_MM[0])
    return FRAMES / rates_hz[1] + distance_mm / stage.speed_mm_per_s + RAMP_S + stage.settle_s
