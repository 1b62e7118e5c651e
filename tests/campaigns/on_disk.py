"""What a run's folder holds, read as a stranger would: by its bytes."""

import hashlib
import json
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from irpmd_rig.recipes.plan import plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.store import RunFolder
from irpmd_rig.store.states import TRANSITIONS, RunState

Key = tuple[int, int | None, int | None]
# Two pictures of the same fringes differ by noise only.
SAME = 0.98


def durable_frames(folder: Path) -> dict[str, str]:
    """Path and checksum of every frame that the manifest ever named, withdrawn ones too; a torn last line is none."""
    found = {}
    path = folder / "manifest.jsonl"
    for line in path.read_bytes().split(b"\n")[:-1] if path.exists() else []:
        content = json.loads(line)
        if "path" in content:
            found[content["path"]] = content["sha256"]
    return found


def lost_frames(folder: Path, durable: dict[str, str]) -> list[str]:
    """Which of these frames are not there any more, or not as they were."""
    return [
        path
        for path, digest in durable.items()
        if not (folder / path).is_file() or hashlib.sha256((folder / path).read_bytes()).hexdigest() != digest
    ]


def states(folder: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (folder / "state.jsonl").read_bytes().splitlines()]


def complaints(folder: Path) -> list[str]:
    """Everything that is wrong with a folder at rest: frames, manifest, states."""
    found = [f"{path} is damaged" for path in lost_frames(folder, durable_frames(folder))]
    run = RunFolder(folder)
    files = {f"frames/{path.name}" for path in (folder / "frames").iterdir()} if (folder / "frames").is_dir() else set()
    found += [f"{path} is in no line" for path in sorted(files - set(durable_frames(folder)))]
    steps = [RunState(str(state["state"])) for state in states(folder)]
    found += [f"{before} became {after}" for before, after in pairwise(steps) if after not in TRANSITIONS[before]]
    if steps[-1] is RunState.SUCCEEDED:
        found += incomplete(run)
    return found


def incomplete(run: RunFolder) -> list[str]:
    """Which frames of its recipe a run lacks, or has twice."""
    text = run.recipe_text()
    assert text is not None
    wanted: Counter[tuple[object, ...]] = Counter()
    for station in plan(read_recipe(text)[0]).stations:
        for shot in station.shots:
            sets = range(len(shot.counts)) if shot.role == "fringes" else (None,)
            steps = range(shot.steps) if shot.role == "fringes" else (None,)
            wanted.update((station.index, shot.label, shot.role, number, step) for number in sets for step in steps)
    found = Counter((entry.station, entry.label, entry.role, entry.set, entry.step) for entry in run.manifest())
    wrong = [key for key in {*wanted, *found} if wanted[key] != found[key]]
    return [f"frame {key} is there {found[key]} times, not {wanted[key]}" for key in wrong]


def pictures(folder: Path) -> dict[Key, NDArray[np.float32]]:
    """The frames of a run that count, by station, set and step."""
    return {
        (entry.station, entry.set, entry.step): tifffile.imread(folder / entry.path).astype(np.float32)
        for entry in RunFolder(folder).manifest()
    }


def likeness(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """Correlation of two pictures, a block of 4 x 4 pixels at a time: their noise counts little."""
    return float(np.corrcoef(_blocks(one).ravel(), _blocks(other).ravel())[0, 1])


def shifted(folder: Path, model: dict[Key, NDArray[np.float32]]) -> list[str]:
    """Frames of a run that are not the picture which a run without faults took there."""
    found = []
    for key, picture in pictures(folder).items():
        alike = {other: likeness(picture, of) for other, of in model.items()}
        best = max(alike, key=lambda other: alike[other])
        other = best != key and likeness(model[best], model[key]) < SAME
        if other or alike[key] < SAME:
            found.append(f"frame {key} looks like {best} ({alike[best]:.3f}; {alike.get(key, 0.0):.3f})")
    return found


def _blocks(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    rows, columns = (size // 4 * 4 for size in picture.shape)
    blocks: NDArray[np.float32] = picture[:rows, :columns].reshape(rows // 4, 4, columns // 4, 4).mean((1, 3))
    return blocks
