"""A rig calibrated and an object measured from folders that a script wrote: no daemon, no store, the command alone."""

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from typer.testing import CliRunner

from irpmd_rig.cli.application import app
from irpmd_rig.core import fringe_images
from sims.rig import SimulatedRig
from sims.world import load_world

# A whole calibration is computed in one fixture.
pytestmark = pytest.mark.timeout(300)
PATTERNS = fringe_images((64, 63, 56), 4, (1024, 768))
WHITE = np.full((768, 1024), 255, np.uint8)
FULL_SCALE_DN = 255
TRUE_STEPS_MM = (3.9868, 7.0248, 5.0062, 6.0986)
RUN = """\
kind: {kind}
fringes: {{counts: [64, 63, 56], steps: 4}}
rig:
  drawing: {{camera_xy_mm: [-160, 0], heading: [1, 0], d_point_mm: [125, 0]}}
  checkerboard: {{squares: [12, 14], square_mm: 10}}
"""


class Folder:
    """A run folder in the making."""

    def __init__(self, path: Path, kind: str, rig: SimulatedRig) -> None:
        self._path, self._rig, self._frames = path, rig, 0
        (path / "frames").mkdir(parents=True)
        (path / "run.yaml").write_text(RUN.format(kind=kind))

    def frame(self, picture: NDArray[np.uint8] | None, **line: object) -> None:
        line["path"] = f"frames/{self._frames:04}.tif"
        self._frames += 1
        self._rig.show(picture)
        tifffile.imwrite(self._path / str(line["path"]), self._rig.capture())
        with (self._path / "manifest.jsonl").open("a") as manifest:
            manifest.write(json.dumps(line) + "\n")

    def lit_and_dark(self, **line: object) -> None:
        self._meter()
        self.frame(WHITE, role="white", **line)
        self.frame(None, role="black", **line)

    def fringes(self, **line: object) -> None:
        self._meter()
        for number, step in np.ndindex(3, 4):
            self.frame(PATTERNS[number, step], set=number, step=step, **line)

    def _meter(self) -> None:
        self._rig.show(WHITE)
        exposure_us = 2000.0
        for _ in range(6):
            self._rig.set_exposure(exposure_us)
            brightest = float(np.percentile(self._rig.capture(), 99.9))
            exposure_us *= min(0.85 * FULL_SCALE_DN / max(brightest, 1.0), 4.0)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lab")
    rig = SimulatedRig(load_world("configs/worlds/misaligned.yaml").with_camera_size(384), seed=3)
    take_boards(Folder(path / "camera", "calibrate-camera", rig), rig)
    take_plates(Folder(path / "plate", "calibrate-plate", rig), rig)
    geometry = Folder(path / "geometry", "calibrate-geometry", rig)
    rig.place("mirror")
    rig.move_stage1(0.0)
    geometry.lit_and_dark(label="sprayed", station=0, stage1_mm=0.0)
    rig.set_glass(True)
    take_mirror(geometry, rig, (0.0, -40.0, -80.0, 40.0))
    take_mirror(Folder(path / "reference", "reference", rig), rig, (0.0, 40.0))
    take_object(Folder(path / "object", "measure", rig), rig)
    return path


def take_boards(folder: Folder, rig: SimulatedRig) -> None:
    rig.set_glass(False)
    rig.set_lamp(True)
    for pose in range(15):
        rig.place("board", pose=pose)
        folder.frame(None, label="board", role="plain", station=pose, view=pose)
    rig.move_stage2(40.0)
    rig.place("board_on_plate")
    folder.frame(None, label="board", role="plain", station=15, view=15, stage2_mm=40.0)
    rig.set_lamp(False)


def take_plates(folder: Folder, rig: SimulatedRig) -> None:
    rig.place("plate")
    for station, position_mm in enumerate((0.0, 40.0, 80.0, 120.0, 160.0, 200.0)):
        rig.move_stage2(position_mm)
        folder.fringes(label="plate", station=station, stage2_mm=position_mm)


def take_mirror(folder: Folder, rig: SimulatedRig, positions_mm: tuple[float, ...]) -> None:
    for place, position_mm in enumerate(positions_mm):
        rig.move_stage1(position_mm)
        rig.place("nothing")
        folder.lit_and_dark(label="glass", station=1 + 2 * place, stage1_mm=position_mm)
        rig.place("mirror")
        folder.fringes(label="mirror", station=2 + 2 * place, stage1_mm=position_mm)


def take_object(folder: Folder, rig: SimulatedRig) -> None:
    rig.place("mirror_step_y")
    for station, position_mm in enumerate((0.0, 40.0)):
        rig.move_stage1(position_mm)
        folder.fringes(label="object", station=station, stage1_mm=position_mm)


def reconstruct(*arguments: str) -> dict[str, Any]:
    ended = CliRunner().invoke(app, ["reconstruct", *arguments, "--json"])
    assert ended.exit_code == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert isinstance(told, dict)
    return told


@pytest.fixture(scope="module")
def calibrated(lab: Path) -> dict[str, Any]:
    with contextlib.chdir(lab):
        reconstruct("camera")
        reconstruct("plate", "--calibration", "camera")
        return reconstruct("geometry", "--calibration", "camera", "--calibration", "plate")


def test_calibrations_are_given_by_their_folders(calibrated: dict[str, Any]) -> None:
    assert calibrated["uses"] == {"calibrate-camera": "camera", "calibrate-plate": "plate"}


def test_an_object_is_measured_by_what_its_calibration_was_made_with(
    lab: Path, calibrated: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(lab)
    reconstruct("reference", "--calibration", "geometry")
    told = reconstruct("object", "--calibration", "geometry", "--reference", "reference")
    assert told["uses"] == calibrated["uses"] | {"calibrate-geometry": "geometry", "reference": "reference"}
    result = json.loads((lab / "object" / "results" / "result.json").read_text())
    assert result["method"] == "facets"
    assert len(result["steps"]) == len(TRUE_STEPS_MM)
    for step, true_mm in zip(result["steps"], TRUE_STEPS_MM, strict=True):
        assert abs(step["measured_mm"] - true_mm) < 4e-3 * step["uncertainty_um"]
