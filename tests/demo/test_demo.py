"""The whole chain from rendered, noisy frames, at a quarter of the paper's resolution."""

import io
import json

import cv2
import numpy as np
import pytest
import tifffile
from plyfile import PlyData
from rich.console import Console

from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.demo.run import Request, run
from irpmd_rig.shipped import CONFIGS

SIZE = 512


@pytest.fixture(scope="module")
def aligned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("aligned") / "demo"
    return run(Request("aligned", "mirror_step_y", folder, None, SIZE), Console(quiet=True))


def test_the_steps_of_table_2_are_measured_in_an_aligned_rig(aligned):
    content = aligned.as_json()
    assert content["true_steps_mm"] == pytest.approx([3.9868, 7.0248, 5.0062, 6.0986])
    errors = np.array(content["measured_steps_mm"]) - content["true_steps_mm"]
    assert np.abs(errors).max() < 0.015
    for step in content["steps"]:
        assert abs(step["error_um"]) < 4 * step["uncertainty_um"]


def test_the_calibration_finds_the_truth_within_its_uncertainty(aligned):
    calibration = aligned.as_json()["calibration"]
    assert abs(calibration["fx_px"] - calibration["fx_true_px"]) < 4 * calibration["fx_sigma_px"]
    assert abs(calibration["d_mm"] - calibration["d_true_mm"]) < max(0.03, 4 * calibration["d_sigma_mm"])
    assert calibration["gamma_deg"] < 0.05


def test_everything_is_written(aligned):
    folder = aligned.out
    depth = np.load(folder / "depth_mm.npy")
    assert depth.shape == (SIZE, SIZE)
    np.testing.assert_array_equal(tifffile.imread(folder / "depth_mm.tif"), depth)
    vertices = PlyData.read(str(folder / "points.ply"))["vertex"]
    assert len(vertices) == np.isfinite(depth).sum()
    assert json.loads((folder / "result.json").read_text()) == json.loads(json.dumps(aligned.as_json()))
    written = json.loads((folder / "calibration.json").read_text())
    assert written["geometry"]["d_mm"] == aligned.calibration.geometry.d_mm
    for picture in ("frames", "wrapped_phase", "absolute_phase", "depth", "facets", "surface"):
        assert cv2.imread(str(folder / f"{picture}.png")).std() > 5


def test_the_tables_show_truth_and_paper_beside_the_measurement(aligned):
    printed = io.StringIO()
    aligned.print(Console(file=printed, width=100))
    shown = printed.getvalue()
    for text in ("3.9868", "4.0081", "+21.3", "truth", "sigma"):
        assert text in shown


def steps_of_seed(seed, folder):
    request = Request("misaligned", "mirror_step_y", folder, seed, 320)
    return run(request, Console(quiet=True)).as_json()["measured_steps_mm"]


@pytest.fixture(scope="module")
def seed_11(tmp_path_factory):
    return steps_of_seed(11, tmp_path_factory.mktemp("seed11"))


def test_a_seed_gives_the_same_measurement_again(seed_11, tmp_path):
    assert len(seed_11) == 4
    # Equal but for the order in which threads add numbers up.
    assert steps_of_seed(11, tmp_path) == pytest.approx(seed_11, abs=1e-9)


def test_another_seed_gives_another_measurement(seed_11, tmp_path):
    assert np.abs(np.subtract(steps_of_seed(12, tmp_path), seed_11)).max() > 1e-4


def test_stages_that_do_not_reach_are_said_before_anything_is_measured(tmp_path):
    world = (CONFIGS / "worlds" / "aligned.yaml").read_text(encoding="utf-8")
    short = tmp_path / "short.yaml"
    short.write_text(world.replace("travel_mm: [-80.0, 220.0]", "travel_mm: [-80.0, 20.0]"), encoding="utf-8")
    with pytest.raises(MeasurementError, match="stage1"):
        run(Request(str(short), "mirror_step_y", tmp_path, None, 320), Console(quiet=True))


def test_an_unknown_object_is_refused(tmp_path):
    with pytest.raises(MeasurementError, match="it has"):
        run(Request("aligned", "teapot", tmp_path, None, SIZE), Console(quiet=True))
