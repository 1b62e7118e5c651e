"""Reports of runs that are no measurements, from what is on disk of them."""

from pathlib import Path

import numpy as np
import pytest

from irpmd_rig.report.content import Facts, Page, Table, Text
from irpmd_rig.report.reading import read_run
from irpmd_rig.report.run import run_page, write_report
from irpmd_rig.store import ManifestEntry, RunFolder, RunRecord
from irpmd_rig.store.record import write_record

PLANE = {"q_per_mm": [0, 0, 0.003], "covariance_per_mm2": np.eye(3).tolist(), "rms_mm": 0.02, "pixels": 15000}
RIG_MODEL = {
    "parameters": [
        {"name": "camera.fx", "value": 2355.0348, "sigma": 0.0071, "unit": "px"},
        {"name": "glass.height", "value": 180.0019, "sigma": 0.0012, "unit": "mm"},
        {"name": "projector.fx", "value": 1700.2, "sigma": 0.5, "unit": "px"},
    ],
    "covariance": [[5.0e-5, 0, 0], [0, 1.44e-6, -0.99 * 6e-4], [0, -0.99 * 6e-4, 0.25]],
    "chi2_per_dof": 1.04,
    "chi2_by_region": {"mirror": 1.1, "sprayed": 1.0, "glass": 1.02},
    "positions_mm": [0.0, -40.0],
    "stage_offsets_mm": [0.0, 0.0012],
    "flexible": False,
    "undetermined": ["the scale of lengths: it is the stage's"],
    "d_mm": 180.0012,
    "sigma_d_mm": 0.0021,
}
GEOMETRY = {
    "d_mm": 180.0012,
    "sigma_d_mm": 0.0059,
    "sigma_parts_um": {"planes": 2.2, "plate's place": 4.0},
    "gamma_deg": 0.105,
    "alpha_deg": 89.9,
    "beta_deg": 90.0,
    "stage1_mm": 0.0,
    "d_seen_mean_mm": 180.14,
    "camera_mm": [-160.0, 0.0, 330.0],
    "mirror": PLANE,
    "glass": PLANE,
    "rig_model": RIG_MODEL,
    "stations": [],
}
LENS = {
    "size_px": [64, 48],
    "focal_px": [80.0, 80.1],
    "principal_point_px": [31.0, 24.0],
    "distortion": [-0.14, 0.15, 0.0, 0.0, 0.0],
    "sigma_focal_px": [0.05, 0.06],
    "sigma_principal_point_px": [0.03, 0.03],
    "sigma_distortion": [0.0004, 0.003, 2e-5, 2e-5, 0.0],
    "pixel_error_px": [0.03, 0.029],
}
BOARD = {"view": 0, "rms_px": 0.04}


def run_of(folder: Path, kind: str, content: dict | None, name: str = "calibration.json") -> RunFolder:
    folder.mkdir()
    write_record(RunRecord(kind=kind, name="a run"), folder / "run.yaml")
    run = RunFolder(folder)
    run.write_frame(np.full((48, 64), 100, np.uint8), ManifestEntry(label="board", role="plain", view=0))
    run.flush()
    run.close()
    if content is not None:
        run.results.write_json(name, {"kind": kind, "size_px": [64, 48], "uses": {}, "versions": {}, **content})
    return run


def page_of(run: RunFolder) -> Page:
    return run_page(read_run(run, None))


def section(page: Page, heading: str):
    return next(section for section in page.sections if section.heading == heading)


def test_a_camera_says_its_focal_lengths_and_what_was_held(tmp_path: Path):
    page = page_of(
        run_of(tmp_path / "run", "calibrate-camera", {"intrinsics": LENS, "boards": [BOARD], "missed_views": [3]})
    )
    assert page.verdict.headline == "fx 80.000 ± 0.050 px, fy 80.100 ± 0.060 px"
    assert "1 boards found, not found in 1 pictures" in page.verdict.told
    facts = dict(next(block for block in section(page, "Lens").blocks if isinstance(block, Facts)).rows)
    assert facts["k1"] == "-0.14000 ± 0.00040"
    assert facts["k3"] == "0 (held)"
    assert {picture.name for picture in page.pictures} == {"pixel_error", "distortion", "frames"}


def test_the_distortion_is_what_the_lens_does(tmp_path: Path):
    page = page_of(
        run_of(tmp_path / "run", "calibrate-camera", {"intrinsics": LENS, "boards": [BOARD], "missed_views": []})
    )
    shift = next(p for p in page.pictures if p.name == "distortion").figure.axes[0].images[0].get_array()
    seen = ideal = np.hypot(31 / 80, 24 / 80.1)
    for _ in range(50):
        ideal = seen / (1 - 0.14 * ideal**2 + 0.15 * ideal**4)
    assert shift[24, 31] < 0.01
    assert shift[0, 0] == pytest.approx(80 * (ideal - seen), rel=0.01)


def test_a_geometry_says_d_and_what_the_rig_model_cannot_tell(tmp_path: Path):
    run = run_of(tmp_path / "run", "calibrate-geometry", GEOMETRY)
    cells = np.zeros((4, 6), np.float32)
    regions = np.zeros((48, 64), bool)
    arrays = {"sprayed": regions, "glass": regions, "residual_at_0_mm": cells, "residual_at_-40_mm": cells}
    run.results.write_arrays("arrays.npz", arrays)
    page = page_of(run)
    assert page.verdict.headline == "d 180.0012 ± 0.0059 mm"
    assert "χ² 1.04" in page.verdict.told
    model = section(page, "Rig model")
    assert Text("Not determined: the scale of lengths: it is the stage's.") in model.blocks
    assert dict(model.blocks[0].rows)["stage 1 beside its reading"] == "+0.00 µm at 0 mm, +1.20 µm at -40 mm"
    titles = [axes.get_title() for axes in model.blocks[-1].figure.axes]
    assert titles[:2] == ["at 0 mm", "at -40 mm"]


def test_parameters_that_are_known_only_together_are_named(tmp_path: Path):
    page = page_of(run_of(tmp_path / "run", "calibrate-geometry", GEOMETRY))
    parameters, correlations = section(page, "Parameters of the rig model").blocks
    assert isinstance(parameters, Table)
    assert parameters.rows[0] == ("camera.fx", "2355.0348 ± 0.0071", "px")
    assert correlations.rows == (("glass.height", "projector.fx", "-0.990"),)


def test_a_geometry_of_one_position_has_no_rig_model(tmp_path: Path):
    page = page_of(run_of(tmp_path / "run", "calibrate-geometry", {**GEOMETRY, "rig_model": None}))
    assert all("Rig model" not in section.heading for section in page.sections)


def test_a_plate_says_which_order_and_what_it_leaves(tmp_path: Path):
    residuals = [{"order": k, "pixel_um": 100.0 / k, "coherent_um": 50.0 / k} for k in (1, 2, 3)]
    content = {"order": 2, "residuals": residuals, "positions_mm": [0.0, 20.0], "valid_fraction": 0.97}
    page = page_of(run_of(tmp_path / "run", "calibrate-plate", content))
    assert page.verdict.headline == "Polynomials of order 2, residual 50.0 µm a pixel"


def test_a_reference_shows_its_phases(tmp_path: Path):
    content = {"positions_mm": [0.0, 40.0], "stations": [{"station": 0, "noise_rad": 0.008}]}
    run = run_of(tmp_path / "run", "reference", content)
    run.results.write_arrays("arrays.npz", {f"position_{k}_rad": np.ones((48, 64)) for k in (1, 2)})
    page = page_of(run)
    assert page.verdict.headline == "Reference at 0, 40 mm"
    titles = [axes.get_title() for axes in page.pictures[0].figure.axes]
    assert titles[:2] == ["stage 1 at 0 mm", "stage 1 at 40 mm"]


def test_any_other_kind_shows_its_figures_and_frames(tmp_path: Path):
    run = run_of(tmp_path / "run", "sequence", {"gamma": 2.2, "levels": [0, 128, 255], "remark": "fine"})
    assert write_report(run) == ("frames.svg", "report.html")
    found = section(page_of(run), "What was found").blocks[0]
    assert found.rows == (("gamma", "2.20000"), ("levels", "0, 128, 255"), ("remark", "fine"))
