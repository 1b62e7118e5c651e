"""What the tests of the store have in common."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.store import Fringes, ManifestEntry, Reason, RunFolder, RunRecord, RunState, Store, Transition
from irpmd_rig.store.record import CALIBRATIONS

RECORD = RunRecord(
    kind="measure",
    name="three facets",
    operator="A. Person",
    sample="S-7",
    fringes=Fringes(counts=(64, 63, 56), steps=4),
)
QUEUED = Transition(RunState.QUEUED, order=1)
TO_SUCCESS = (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED)


def picture(index: int, size_px: int = 64) -> NDArray[np.uint8]:
    """A picture that only this index has."""
    return np.random.default_rng(index).integers(0, 256, (size_px, size_px), dtype=np.uint8)


def entry(index: int, **changes: object) -> ManifestEntry:
    known = {"station": index // 12, "set": index // 4 % 3, "step": index % 4, "stage1_mm": 40.0 * (index // 12)}
    return ManifestEntry.model_validate(known | changes)


def new_run(root: Path, record: RunRecord = RECORD) -> RunFolder:
    return Store(root).create_run(record, QUEUED)


def succeeded(store: Store, **record: object) -> RunFolder:
    folder = store.create_run(RunRecord.model_validate({"kind": "measure"} | record), QUEUED)
    if folder.record().kind in (*CALIBRATIONS, "reference"):
        folder.results.write_json("calibration.json", {})
    for state in TO_SUCCESS:
        folder.append_state(Transition(state))
    return folder


def fail(folder: RunFolder, reason: Reason = Reason.FRAMES_LOST) -> None:
    folder.append_state(Transition(RunState.FAILED, reason))
