"""The report of a run folder: what it says, and what it does where something is missing."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from measured_run import NOISE_UM, WINDOW, heights, result, write_measured_run
from pages import Parts
from typer.testing import CliRunner

from irpmd_rig.cli import app
from irpmd_rig.report.content import Text
from irpmd_rig.report.reading import read_run
from irpmd_rig.report.run import run_page, write_report
from irpmd_rig.report.shape import read_shape, residuals
from irpmd_rig.store import Reason, RunFolder, RunFolderError, RunState, Transition

ENDED = (
    Transition(RunState.QUEUED),
    Transition(RunState.PREPARING),
    Transition(RunState.FAILED, Reason.FRAME_QUALITY, "a frame is stale"),
)


def page_of(folder: RunFolder):
    return run_page(read_run(folder, None))


def texts(folder: RunFolder) -> str:
    write_report(folder)
    return " ".join(Parts(folder.results.path("report.html").read_text("utf-8")).texts)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return write_measured_run(tmp_path_factory.mktemp("runs") / "a-run", result())


@pytest.fixture(scope="module")
def told(measured: RunFolder) -> str:
    return texts(measured)


def test_the_answer_comes_first(measured: RunFolder):
    page = page_of(measured)
    assert page.verdict.passed is True
    assert page.verdict.headline == "Step: 4.00120 ± 0.00094 mm"
    assert page.verdict.told == "± is one standard deviation. All 4 checks passed."
    assert page.sections[0].heading == "Steps"


def test_everything_is_said(told: str):
    for text in (
        "a step", "M-17", "Anna", "4.0012", "+1.2", "facets, for the recipe names it", "depth-equation",
        "there is no reference", "of this camera, not too old", "180.0000 ± 0.0020", "64, 63, 56", "numpy",
        "its folder is not at hand",
    ):  # fmt: skip
        assert text in told


def test_its_figures_are_files_as_well(measured: RunFolder, told: str):
    expected = {
        "steps", "step_uncertainty", "methods", "surface", "depth", "sigma", "facets", "residuals",
        "residual_histogram", "frames", "wrapped_phase", "absolute_phase",
    }  # fmt: skip
    names = set(measured.results.names())
    assert {f"{name}.svg" for name in expected} <= names
    assert all(f"{name}.svg" in told for name in expected)
    assert measured.results.path("report.html").stat().st_size < 2_000_000


def test_residuals_are_heights_beside_the_fitted_facets(measured: RunFolder):
    shape = read_shape(read_run(measured, None))
    assert shape.window == WINDOW
    known = shape.residual_um[np.isfinite(shape.residual_um)]
    assert known.size == 2240
    assert known.std() == pytest.approx(NOISE_UM, rel=0.1)


def test_residuals_of_a_method_that_fits_surfaces_are_beside_these(tmp_path: Path):
    content = result()
    content["methods"]["facets"]["depth_file"] = "depth_facets_mm.npy"
    run = write_measured_run(tmp_path / "run", content)
    run.results.write_array("depth_facets_mm.npy", run.results.read_array("depth_mm.npy") - np.float32(1e-3))
    shape = read_shape(read_run(run, None))
    np.testing.assert_allclose(shape.residual_um[shape.labels > 0], 1.0, atol=1e-3)


def test_a_curved_facet_is_compared_with_a_smooth_surface():
    _, points, labels = heights()
    x, y = points[..., 0], points[..., 1]
    curved = np.dstack([x, y, ((x - 25) ** 2 + (y - 17) ** 2) / 200])
    left = residuals(curved.astype(np.float32), labels, [{"facet": 1, "flat": False}])
    assert np.nanmax(np.abs(left[labels == 1])) < 0.05
    assert np.isnan(left[labels != 1]).all()


def test_a_check_that_was_not_passed_is_the_verdict(tmp_path: Path):
    content = result()
    content["checks"][0] = {"name": "calibration", "passed": False, "says": "80 days old, the rig file allows 30"}
    page = page_of(write_measured_run(tmp_path / "run", content))
    assert page.verdict.passed is False
    assert "calibration" in page.verdict.told


def test_a_run_that_failed_says_why(tmp_path: Path):
    run = write_measured_run(tmp_path / "run", None)
    for transition in ENDED:
        run.append_state(transition)
    page = page_of(run)
    assert page.verdict.passed is False
    assert "frame_quality" in page.verdict.headline
    assert page.verdict.told == "a frame is stale"
    assert "Camera frames" in " ".join(picture.alt for picture in page.pictures)


def test_without_results_the_frames_are_shown(tmp_path: Path):
    page = page_of(write_measured_run(tmp_path / "run", None))
    assert page.verdict.passed is None
    assert "Nothing was computed" in page.verdict.headline
    assert [picture.name for picture in page.pictures] == ["frames"]


def test_frames_that_are_gone_are_said_to_be(tmp_path: Path):
    run = write_measured_run(tmp_path / "run", result())
    shutil.rmtree(run.path / "frames")
    section = next(s for s in page_of(run).sections if s.heading == "Frames and phases")
    assert section.blocks == (Text("The frames are not in the folder any more."),)


def test_a_measurement_without_steps_says_why(tmp_path: Path):
    content = result() | {"steps": [], "facets": [], "methods": {}, "without_steps": "no facet was found"}
    page = page_of(write_measured_run(tmp_path / "run", content))
    assert page.verdict.headline == "A depth map of 2240 pixels, 0 facets"
    assert "no facet was found" in page.verdict.told


def test_results_that_are_not_whole_are_refused(tmp_path: Path):
    content = result()
    del content["steps"]
    run = write_measured_run(tmp_path / "run", content)
    with pytest.raises(RunFolderError, match="reconstruct the run"):
        write_report(run)
    assert "report.html" not in run.results.names()


def test_calibrations_beside_the_run_are_named_with_what_they_found(tmp_path: Path):
    run = write_measured_run(tmp_path / "run", result())
    beside = tmp_path / "geometry" / "results"
    beside.mkdir(parents=True)
    found = {"created": "2026-11-20T10:00:00+00:00", "d_mm": 180.001, "sigma_d_mm": 0.0021, "rig_model": None}
    (beside / "calibration.json").write_text(json.dumps(found))
    section = next(s for s in page_of(run).sections if s.heading == "Calibrations used")
    kind, _, _, days_before, told = section.blocks[0].rows[0]
    assert (kind, days_before, told) == ("calibrate-geometry", "2.00", "d 180.0010 ± 0.0021 mm")


def test_the_command_writes_it_and_names_the_page(tmp_path: Path):
    run = write_measured_run(tmp_path / "run", result())
    done = CliRunner().invoke(app, ["report", str(run.path)])
    assert done.exit_code == 0, done.output
    assert done.output.strip() == str(run.path / "results" / "report.html")
    assert (run.path / "results" / "steps.svg").is_file()


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path):
    done = CliRunner().invoke(app, ["report", str(tmp_path)])
    assert isinstance(done.exception, RunFolderError)
