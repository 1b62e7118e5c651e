"""The commands that work on files alone, in an empty folder: validate, export, reconstruct, safe."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from irpmd_rig.shipped import CONFIGS
from irpmd_rig.store import ManifestEntry, RunFolder, RunRecord, RunState, Store, Transition


def typed(folder: Path, *arguments: object) -> tuple[int, str, str]:
    ended = subprocess.run(
        [sys.executable, "-m", "irpmd_rig", *map(str, arguments)],
        cwd=folder, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert "Traceback" not in ended.stderr
    return ended.returncode, ended.stdout, ended.stderr


def test_what_ships_is_right_by_name_in_an_empty_folder(tmp_path: Path) -> None:
    names = [path.stem for kind in ("rigs", "recipes") for path in (CONFIGS / kind).glob("*.yaml")]
    status, said, noted = typed(tmp_path, "validate", "misaligned", *names)
    assert status == 0, noted
    assert said.count("rig file, right") == 3
    assert said.count("recipe, right") == len(names) - 3
    assert "world, right: 6 objects" in said
    assert not list(tmp_path.iterdir())


def test_every_mistake_of_every_file_is_placed(tmp_path: Path) -> None:
    for kind, name, old, new in (
        ("rigs", "sim", "driver: harvesters", "driver: harvester"),
        ("recipes", "paper-measure", "positions_mm", "positionen_mm"),
        ("worlds", "aligned", "psf_px", "psf_pxl"),
    ):
        text = (CONFIGS / kind / f"{name}.yaml").read_text(encoding="utf-8").replace(old, new)
        (tmp_path / f"{kind}.yaml").write_text(text.replace("../worlds/", f"{CONFIGS}/worlds/"), encoding="utf-8")
    (tmp_path / "text.yaml").write_text("just a text\n", encoding="utf-8")
    status, said, noted = typed(tmp_path, "validate", "rigs.yaml", "recipes.yaml", "worlds.yaml", "text.yaml")
    assert (status, said) == (1, "")
    for place, says in (
        ("rigs.yaml:6:", "harvesters"), ("recipes.yaml:7:1:", "positions_mm"), ("worlds.yaml:", "psf_px"),
        ("text.yaml:1:1:", "mapping"),
    ):  # fmt: skip
        assert place in noted
        assert says in noted


def test_a_recipe_is_checked_against_the_limits_of_a_rig(tmp_path: Path) -> None:
    text = (CONFIGS / "recipes" / "reference.yaml").read_text(encoding="utf-8")
    (tmp_path / "far.yaml").write_text(text.replace("[0, 40]", "[0, 900]"), encoding="utf-8")
    assert typed(tmp_path, "validate", "far.yaml")[0] == 0
    status, _, noted = typed(tmp_path, "validate", "far.yaml", "--rig", "lab.example")
    assert status == 1
    assert "far.yaml:5:" in noted


def test_a_file_that_is_not_there_is_no_verdict(tmp_path: Path) -> None:
    status, _, noted = typed(tmp_path, "validate", "nowhere.yaml")
    assert status == 2
    assert "paper-measure" in noted


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A succeeded run of one frame in the store `data`."""
    store = Store(tmp_path / "data")
    folder = store.create_run(RunRecord(kind="sequence", name="one frame"), Transition(RunState.QUEUED))
    folder.write_frame(np.full((8, 12), 7, np.uint8), ManifestEntry(path="", label="one", role="plain"))
    folder.close()
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED):
        folder.append_state(Transition(state))
    store.close()
    return folder


def test_a_run_is_exported_by_its_id_or_its_folder(run: RunFolder, tmp_path: Path) -> None:
    status, said, noted = typed(tmp_path, "export", run.id, "--form", "hdf5")
    assert status == 0, noted
    with h5py.File(tmp_path / said.strip()) as file:
        assert file.attrs or len(file)
    assert typed(tmp_path, "export", run.path, "--form", "hdf5", "--out", "mine.h5")[0] == 0
    status, _, noted = typed(tmp_path, "export", run.id, "--form", "ply")
    assert status == 2
    assert "reconstruct" in noted
    assert typed(tmp_path, "export", "20000101-000000-000000", "--form", "ply")[0] == 2


def test_folders_are_computed_one_after_the_other_whatever_is_wrong_with_one(run: RunFolder, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    status, said, noted = typed(tmp_path, "reconstruct", "empty", run.path)
    assert status == 1
    assert "empty: " in noted
    assert "run.yaml" in noted
    assert f"{run.path}: sequence" in said
    status, _, noted = typed(tmp_path, "reconstruct", run.path, "--calibration", "empty")
    assert status == 1
    assert "run.yaml" in noted


def test_without_a_running_world_there_is_nothing_to_make_safe(tmp_path: Path) -> None:
    world = CONFIGS / "worlds" / "aligned.yaml"
    text = (CONFIGS / "rigs" / "sim.yaml").read_text(encoding="utf-8").replace("../worlds/misaligned.yaml", str(world))
    (tmp_path / "rig.yaml").write_text(text + f"simulation: {{folder: {tmp_path / 'world'}}}\n", encoding="utf-8")
    status, said, _ = typed(tmp_path, "safe", "rig.yaml")
    assert status == 0
    assert "nothing to make safe" in said
    assert not (tmp_path / "data").exists()
