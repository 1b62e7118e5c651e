"""The example of the README: a run folder that a script of twenty lines wrote."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from runs_on_disk import picture

from irpmd_rig.store import RunFolder
from irpmd_rig.store.export import export_run

SCRIPT = Path(__file__).with_name("hand_written_run.py")


@pytest.fixture(scope="module")
def frames() -> np.ndarray:
    return np.stack([picture(index) for index in range(24)]).reshape(2, 3, 4, 64, 64)


@pytest.fixture(scope="module")
def folder(frames: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    path = tmp_path_factory.mktemp("by_hand")
    np.save(path / "frames.npy", frames)
    subprocess.run([sys.executable, str(SCRIPT), str(path / "frames.npy"), str(path / "run")], check=True)
    return RunFolder(path / "run")


def test_it_is_read_with_what_the_manifest_does_not_say(folder: RunFolder, frames: np.ndarray) -> None:
    assert folder.record().kind == "measure"
    assert folder.state() is None
    entries = folder.frames(role="fringes", label="object")
    assert [entry.index for entry in entries] == list(range(24))
    for entry in entries:
        assert (entry.counts, entry.steps) == ((64, 63, 56), 4)
        assert entry.stage1_mm == (0.0, 40.0)[entry.station]
        assert np.array_equal(folder.read_frame(entry), frames[entry.station, entry.set, entry.step])


def test_it_needs_no_mending_and_can_be_exported(folder: RunFolder) -> None:
    found = folder.reconcile()
    assert (found.frames, found.lost, found.unknown, found.removed) == (24, (), (), ())
    assert export_run(folder, "hdf5", folder.path.parent / "run.nxs.h5").stat().st_size > 24 * 64 * 64


def test_the_script_is_short() -> None:
    lines = [line for line in SCRIPT.read_text().splitlines() if line.strip()]
    assert len(lines) <= 21
