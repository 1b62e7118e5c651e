"""Fill a small file system of one's own with frames, and tell as JSON how that ended."""

import ctypes
import json
import os
import sys
from pathlib import Path

from runs_on_disk import QUEUED, RECORD, entry, picture

from irpmd_rig.store import DiskFull, Reason, RunFolder, RunState, Store, Transition
from irpmd_rig.store.export import write_nexus

root = Path(sys.argv[1])
if ctypes.CDLL(None, use_errno=True).mount(b"tmpfs", os.fsencode(root), b"tmpfs", 0, b"size=2m"):
    sys.exit(f"cannot mount: {os.strerror(ctypes.get_errno())}")
store = Store(root)
folder = store.create_run(RECORD, QUEUED)
durable, full = 0, None
try:
    for index in range(100):
        folder.write_frame(picture(index, size_px=256), entry(index))
        folder.flush()
        durable += 1
except DiskFull as error:
    full = str(error)
folder.append_state(Transition(RunState.FAILED, Reason.DISK_FULL))
found = RunFolder(folder.path).reconcile()
export = None
try:
    with (root / "run.h5").open("w+b") as stream:
        write_nexus(stream, folder)
except OSError as error:
    export = error.errno
outcome = {
    "durable": durable,
    "full": full,
    "export": export,
    "frames": found.frames,
    "wrong": [*found.lost, *found.unknown, *found.removed],
    "state": store.runs()[0].state,
    "index": [run.state for run in Store(root).runs()],
}
sys.stdout.write(json.dumps(outcome) + "\n")
