"""The whole chain over REST from rendered, noisy frames, at a fraction of the paper's resolution."""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from plyfile import PlyData
from rich.console import Console

from irpmd_rig.client import Client
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.demo import lab_script
from irpmd_rig.demo.private_daemon import PrivateDaemon, SimulatedRig
from irpmd_rig.demo.run import Request, run
from irpmd_rig.shipped import world_file

SIZE = 512
# Three calibrations from scratch: half a minute each on two cores that have nothing else to do.
pytestmark = pytest.mark.timeout(900)


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


def test_everything_is_written_and_nothing_else_is_left(aligned):
    folder = aligned.out
    depth = np.load(folder / "depth_mm.npy")
    assert depth.shape == (SIZE, SIZE)
    np.testing.assert_array_equal(tifffile.imread(folder / "depth_mm.tif"), depth)
    vertices = PlyData.read(str(folder / "points.ply"))["vertex"]
    assert len(vertices) == np.isfinite(depth).sum()
    assert json.loads((folder / "result.json").read_text()) == json.loads(json.dumps(aligned.as_json()))
    written = json.loads((folder / "calibration.json").read_text())
    assert written["geometry"]["d_mm"] == aligned.as_json()["calibration"]["d_mm"]
    with np.load(folder / "references.npz") as references:
        assert references["position_1_rad"].shape == (SIZE, SIZE)
    for picture in ("frames", "wrapped_phase", "absolute_phase", "depth", "facets", "surface"):
        assert "<image" in (folder / f"{picture}.svg").read_text() or picture == "surface"
    assert not list(folder.glob(".*"))


def test_the_tables_show_truth_and_paper_beside_the_measurement(aligned):
    printed = io.StringIO()
    aligned.print(Console(file=printed, width=100))
    shown = printed.getvalue()
    for text in ("3.9868", "4.0081", "+21.3", "truth", "sigma"):
        assert text in shown


def test_an_unknown_object_is_refused(tmp_path):
    with pytest.raises(MeasurementError, match="mirror_step_y"):
        run(Request("aligned", "teapot", tmp_path, None, SIZE), Console(quiet=True))
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A daemon as in a lab, and the folder that a script is started in: with data/token below it."""
    folder = tmp_path_factory.mktemp("lab")
    with PrivateDaemon(SimulatedRig(world_file("aligned"), 11, 320, 20.0), folder) as client:
        yield client, folder


def test_the_script_is_printed_in_the_readme():
    readme = Path(__file__).parents[2] / "README.md"
    assert Path(lab_script.__file__).read_text(encoding="utf-8") in readme.read_text(encoding="utf-8")


def test_the_script_of_the_readme_runs_as_it_is_printed(lab):
    client, folder = lab
    text = Path(lab_script.__file__).read_text(encoding="utf-8").replace("Client()", f"Client({client.url!r})")
    (folder / "script.py").write_text(text, encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "script.py", "mirror_step_y"],
        cwd=folder, capture_output=True, text=True, timeout=800, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert [line.split(":")[0] for line in lines] == ["1-2", "2-3", "3-4", "4-5"]
    for line, true_mm in zip(lines, (3.9868, 7.0248, 5.0062, 6.0986), strict=True):
        assert float(line.split()[1]) == pytest.approx(true_mm, abs=0.5)
    assert (folder / "mirror_step_y" / "points.ply").is_file()


def test_the_demonstration_finds_what_the_script_finds_with_the_same_seed(lab, tmp_path):
    client, _ = lab
    scripted = client.result(next(run for run in client.runs() if run.kind == "measure").id)
    shown = run(Request("aligned", "mirror_step_y", tmp_path, 11, 320), Console(quiet=True)).as_json()
    assert shown["seed"] == 11
    # Equal to a nanometre: threads add numbers up in any order, and what is iterated ends a little elsewhere.
    assert shown["measured_steps_mm"] == pytest.approx(scripted["measured_steps_mm"], abs=1e-6)


def reconstruct(folder, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "irpmd_rig", "reconstruct", *map(str, arguments)],
        cwd=folder, capture_output=True, text=True, timeout=800, check=False,
    )  # fmt: skip


def test_a_run_is_computed_again_from_its_folder_to_the_same_numbers(lab):
    client, folder = lab
    run = next(run for run in client.runs() if run.kind == "measure")
    first = client.array(run.id, "depth_mm.npy")
    (folder / "data" / run.id / "results" / "depth_mm.npy").unlink()
    ended = reconstruct(folder, Path("data") / run.id)
    assert ended.returncode == 0, ended.stderr
    assert "facets: 5" in ended.stdout
    np.testing.assert_array_equal(np.load(folder / "data" / run.id / "results" / "depth_mm.npy"), first)


def test_a_folder_written_by_hand_is_computed_with_the_calibration_that_is_given(lab, tmp_path):
    client, folder = lab
    taken = next(run for run in client.runs() if run.kind == "measure")
    write_by_hand(client, taken.id, tmp_path / "mine")
    runs = {run.kind: folder / "data" / run.id for run in client.runs()}
    # From a folder without a store: nothing is active here.
    refused = reconstruct(tmp_path, "mine")
    assert refused.returncode == 1
    assert "calibrate-geometry" in refused.stderr
    given = ("--calibration", runs["calibrate-geometry"], "--reference", runs["reference"])
    ended = reconstruct(tmp_path, "mine", "--json", *given)
    assert ended.returncode == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["uses"]["calibrate-camera"] == runs["calibrate-camera"].name
    depth = np.load(tmp_path / "mine" / "results" / "depth_mm.npy")
    np.testing.assert_array_equal(depth, client.array(taken.id, "depth_mm.npy"))
    assert not (tmp_path / "index.sqlite").exists()
    swapped = reconstruct(tmp_path, "mine", "--calibration", runs["reference"], "--reference", runs["reference"])
    assert swapped.returncode == 1
    assert "is a reference" in swapped.stderr


def write_by_hand(client: Client, run_id: str, folder: Path) -> None:
    """Write the frames of a run as a script of the lab would that knows nothing of the daemon."""
    (folder / "frames").mkdir(parents=True)
    (folder / "run.yaml").write_text("kind: measure\nfringes: {counts: [64, 63, 56], steps: 4}\n", encoding="utf-8")
    with (folder / "manifest.jsonl").open("w", encoding="utf-8") as manifest:
        for frame in client.frames(run_id):
            path = f"frames/{frame.station}-{frame.set}-{frame.step}.tif"
            client.download(run_id, frame.path, folder / path)
            entry = {"path": path, "station": frame.station, "set": frame.set, "step": frame.step}
            manifest.write(json.dumps(entry | {"stage1_mm": frame.stage1_mm}) + "\n")
