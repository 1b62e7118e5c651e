"""`python -m sims frames`: what a run's frames would be, without instruments."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from sims.__main__ import app
from sims.rig import SimulatedRig
from sims.world import load_world

RUN = CliRunner()
SIZE_PX = 128


def asked(folder: Path, *stations: dict) -> Path:
    patterns = np.zeros((2, 768, 1024), np.uint8)
    patterns[0] = 255
    patterns[1, :, ::2] = 200
    np.save(folder / "patterns.npy", patterns)
    request = folder / "request.json"
    request.write_text(json.dumps({"patterns": "patterns.npy", "stations": list(stations)}))
    return request


def frames(worlds: Path, request: Path, *options: str) -> list[np.ndarray]:
    out = request.parent / "frames"
    command = ["frames", str(worlds / "misaligned.yaml"), str(request), "--out", str(out), "--size-px", str(SIZE_PX)]
    result = RUN.invoke(app, [*command, *options])
    assert result.exit_code == 0, result.output
    stations = json.loads((out / "frames.json").read_text())["stations"]
    return [np.load(out / station["file"]) for station in stations]


def test_frames_are_those_of_the_rig(worlds: Path, tmp_path: Path) -> None:
    scene = {"subject": "mirror", "glass": False}
    request = asked(
        tmp_path,
        {"scene": scene, "exposure_us": 2000.0, "pictures": [0, None]},
        {"stage1_mm": 40.0, "light": "visible", "exposure_us": 3000.0, "pictures": [1]},
    )
    first, second = frames(worlds, request, "--seed", "7")
    rig = SimulatedRig(load_world(worlds / "misaligned.yaml").with_camera_size(SIZE_PX), seed=7)
    patterns = np.load(tmp_path / "patterns.npy")
    rig.set_glass(False)
    rig.set_exposure(2000.0)
    rig.show(patterns[0])
    np.testing.assert_array_equal(first[0], rig.capture())
    rig.show(None)
    np.testing.assert_array_equal(first[1], rig.capture())
    rig.move_stage1(40.0)
    rig.set_light("visible")
    rig.set_exposure(3000.0)
    rig.show(patterns[1])
    np.testing.assert_array_equal(second[0], rig.capture())


def test_an_exposure_that_is_not_given_is_metered(worlds: Path, tmp_path: Path) -> None:
    request = asked(tmp_path, {"scene": {"subject": "plate", "glass": False}, "metered_on": 0, "pictures": [0]})
    ((white,),) = frames(worlds, request)
    assert np.percentile(white, 99.5) == pytest.approx(0.85 * 255, abs=4)
    (station,) = json.loads((tmp_path / "frames" / "frames.json").read_text())["stations"]
    assert station["exposure_us"] != load_world(worlds / "misaligned.yaml").camera.exposure_us
    assert (station["stage1_mm"], station["stage2_mm"], station["bits"]) == (0, 0, 8)


def test_seeds_give_noise_of_their_own(worlds: Path, tmp_path: Path) -> None:
    request = asked(tmp_path, {"exposure_us": 4000.0, "pictures": [0]})
    first, second, again = (frames(worlds, request, "--seed", seed)[0] for seed in ("1", "2", "1"))
    assert (first != second).mean() > 0.2
    np.testing.assert_array_equal(first, again)


@pytest.mark.parametrize(
    ("station", "complaint"),
    [
        ({"pictures": [2]}, "no picture 2"),
        ({"pictures": []}, "pictures"),
        ({"pictures": [0], "stage3_mm": 0.0}, "there is no 'stations.0.stage3_mm' here"),
        ({"pictures": [0], "stage1_mm": 500.0}, "travels"),
        ({"pictures": [0], "scene": {"subject": "vase"}}, "vase"),
    ],
)
def test_a_wrong_request_is_one_clear_error(worlds: Path, tmp_path: Path, station: dict, complaint: str) -> None:
    command = ["frames", str(worlds / "ideal.yaml"), str(asked(tmp_path, station)), "--out", str(tmp_path / "f")]
    result = RUN.invoke(app, [*command, "--size-px", str(SIZE_PX)])
    assert result.exit_code == 2
    assert complaint in result.stderr
    assert "Traceback" not in result.output


def test_missing_files_are_named(worlds: Path, tmp_path: Path) -> None:
    world = str(worlds / "ideal.yaml")
    result = RUN.invoke(app, ["frames", world, str(tmp_path / "none.json"), "--out", str(tmp_path)])
    assert result.exit_code == 2
    assert "none.json" in result.stderr
    request = asked(tmp_path, {"pictures": [0]})
    (tmp_path / "patterns.npy").unlink()
    result = RUN.invoke(app, ["frames", world, str(request), "--out", str(tmp_path)])
    assert "patterns.npy" in result.stderr
