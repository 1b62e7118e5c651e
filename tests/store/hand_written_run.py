"""Write a run folder by hand: ``python hand_written_run.py frames.npy FOLDER``."""

import json
import sys
from pathlib import Path

import numpy as np
import tifffile

frames = np.load(sys.argv[1])  # uint8 or uint16, (positions, fringe sets, phase steps, height, width)
folder = Path(sys.argv[2])
(folder / "frames").mkdir(parents=True)
(folder / "run.yaml").write_text("kind: measure\nfringes: {counts: [64, 63, 56], steps: 4}\n")
with (folder / "manifest.jsonl").open("w") as manifest:
    for station, stage1_mm in enumerate([0.0, 40.0]):
        for fringes, step in np.ndindex(3, 4):
            path = f"frames/{station}-{fringes}-{step}.tif"
            tifffile.imwrite(folder / path, frames[station, fringes, step])
            frame = {"path": path, "station": station, "set": fringes, "step": step, "stage1_mm": stage1_mm}
            manifest.write(json.dumps(frame) + "\n")
