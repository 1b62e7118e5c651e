"""With a geometry from several stage positions: the rig model, and every method that it makes possible."""

import json
import shutil

import numpy as np
import pytest
from simulated_runs import NOMINAL_MM, SIZE_PX

from irpmd_rig.processing import Refused
from irpmd_rig.processing.archive_rig import model_content, read_model, read_variations
from irpmd_rig.processing.chain import check_uses
from irpmd_rig.processing.glass import glass_mask
from irpmd_rig.processing.process import process
from irpmd_rig.store import Optics, RunFolder
from tests.core.rig_truth import model_of

# Calibrating the rig is the one long computation; on a busy machine it takes its time.
pytestmark = pytest.mark.timeout(600)
METHODS = ("facets", "triangulation", "generalised", "depth-equation")


@pytest.fixture(scope="module")
def geometry(rig_chain):
    return rig_chain.content("calibrate-geometry")


def test_the_rig_is_found_beside_the_papers_geometry(rig_chain, geometry):
    world, rig = rig_chain.runs.rig.world, geometry["rig_model"]
    assert abs(geometry["d_mm"] - 180) < 0.05
    assert abs(rig["d_mm"] - 180) < max(0.01, 4 * rig["sigma_d_mm"])
    found, true = read_model(rig["model"]), model_of(world)
    # Along the fringes the axis hardly matters, and x fringes hardly tell.
    assert abs(found.stage_axis[0] - true.stage_axis[0]) < 1e-4
    assert rig["positions_mm"] == geometry["positions_mm"] == [0, -60, 40]
    assert len(rig["parameters"]) == len(rig["covariance"]) == len(rig["covariance"][0])
    assert {"name", "value", "sigma", "unit"} == set(rig["parameters"][0])
    assert any("scale" in said for said in rig["undetermined"])
    assert 0.3 < rig["chi2_per_dof"] < 5


def test_what_is_written_of_the_rig_is_read_again(rig_chain, geometry):
    results = rig_chain.folders["calibrate-geometry"].results
    model = read_model(geometry["rig_model"]["model"])
    assert model_content(model) == geometry["rig_model"]["model"]
    assert model_content(read_model(model_content(model_of(rig_chain.runs.rig.world))))
    variations = read_variations(results.read_json("rig_variations.json"))
    assert len(variations) > 5
    assert {"residual_at_0_mm", "residual_at_-60_mm", "residual_at_40_mm"} <= set(results.read_arrays("arrays.npz"))


def test_the_glass_is_known_where_nobody_looked(rig_chain, geometry):
    rig = geometry["rig_model"]
    model, outline = read_model(rig["model"]), np.array(rig["glass_outline_mm"])
    seen = rig_chain.folders["calibrate-geometry"].results.read_arrays("arrays.npz")["glass"]
    at_zero, away = (glass_mask(model, outline, position) for position in (0.0, 20.0))
    assert (at_zero & seen).sum() > 0.9 * seen.sum()
    assert 0 < away.sum() < at_zero.sum()
    assert not glass_mask(model, np.empty((0, 2)), 0.0).any()


def test_every_method_gives_the_steps_within_its_uncertainty(rig_chain):
    content = rig_chain.content("measure")
    assert (content["method"], content["method_because"]) == ("facets", "the calibration has a rig model")
    assert set(content["methods"]) == set(METHODS)
    assert content["not_computed"] == {}
    for name, method in content["methods"].items():
        assert len(method["steps"]) == len(NOMINAL_MM), name
        covariance = np.array(method["step_covariance_um2"])
        for k, (step, true_mm) in enumerate(zip(method["steps"], NOMINAL_MM, strict=True)):
            assert abs(step["measured_mm"] - true_mm) < 5e-3 * step["uncertainty_um"], name
            parts = (step["random_um"], step["calibration_um"], step["alignment_um"])
            assert np.hypot.reduce(parts) == pytest.approx(step["uncertainty_um"])
            assert covariance[k, k] == pytest.approx(step["uncertainty_um"] ** 2, rel=1e-6)
        # Neighbouring steps share a facet.
        assert np.abs(np.diag(covariance, 1)).min() > 0
        assert np.linalg.eigvalsh(covariance).min() > 0
    by_facets, by_pixels = (content["methods"][name]["steps"][0]["uncertainty_um"] for name in METHODS[:2])
    assert by_facets < 0.5 * by_pixels


def test_the_chosen_methods_figures_stand_on_top(rig_chain):
    content = rig_chain.content("measure")
    chosen = content["methods"]["facets"]
    assert content["steps"] == chosen["steps"]
    assert content["facets"] == chosen["facets"]
    assert rig_chain.processed["measure"].summary["steps_mm"] == content["measured_steps_mm"]
    assert {check["name"] for check in content["checks"]} >= {"calibration", "rig model", "stage positions"}
    assert all(position["stage1_by_the_glass_mm"] is not None for position in content["positions"])
    for position in content["positions"]:
        assert abs(position["stage1_by_the_glass_mm"] - position["stage1_mm"]) < 0.02


def test_each_method_has_its_maps(rig_chain):
    content, results = rig_chain.content("measure"), rig_chain.folders["measure"].results
    files = {name: (method["depth_file"], method["sigma_file"]) for name, method in content["methods"].items()}
    assert files == {
        "facets": ("depth_facets_mm.npy", "sigma_facets_mm.npy"),
        "triangulation": ("depth_mm.npy", "sigma_mm.npy"),
        "generalised": ("depth_generalised_mm.npy", "sigma_generalised_mm.npy"),
        "depth-equation": ("depth_depth_equation_mm.npy", "sigma_depth_equation_mm.npy"),
    }
    assert (content["depth"]["file"], content["depth"]["sigma_file"]) == files["triangulation"]
    for depth_file, sigma_file in files.values():
        depth, sigma = results.read_array(depth_file), results.read_array(sigma_file)
        assert depth.shape == sigma.shape == (SIZE_PX, SIZE_PX)
        assert np.isfinite(depth).sum() > 2000
        assert (np.isfinite(sigma) == np.isfinite(depth)).mean() > 0.999
    assert [file for _, _, file in rig_chain.told if file][:2] == ["depth_mm.npy", "sigma_mm.npy"]
    stated = content["methods"]["facets"]
    assert stated["stated_noise_of_a_pixel_um"] < 0.2 * stated["noise_of_a_pixel_um"]


def again(rig_chain, path, **recipe):
    """The measurement with another recipe, in a folder of its own."""
    shutil.copytree(rig_chain.folders["measure"].path, path, ignore=shutil.ignore_patterns("results"))
    folder = RunFolder(path)
    folder.amend(recipe={**folder.record().recipe, "compare": [], **recipe})
    return folder


def test_a_reference_is_needed_only_by_what_compares_with_one(rig_chain, tmp_path):
    library, record = rig_chain.runs.library, rig_chain.folders["measure"].record()
    elsewhere = record.model_copy(update={"positions_mm": (-60.0, 40.0)})
    assert check_uses(elsewhere, library)
    equation = elsewhere.model_copy(update={"recipe": {"method": "depth-equation"}})
    with pytest.raises(Refused, match="not at -60 mm"):
        check_uses(equation, library)
    folder = again(rig_chain, tmp_path / "run", compare=["generalised"])
    lines = [json.loads(line) for line in (folder.path / "manifest.jsonl").read_text().splitlines()]
    # The stage is said to have stood elsewhere: the glass in the frames knows better than to follow.
    for line in lines:
        line["stage1_mm"] += 0.05
    (folder.path / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    process(folder, library, lambda _: None)
    content = folder.results.read_json("result.json")
    assert "not at 0.05, 40.05 mm" in content["not_computed"]["generalised"]
    first = content["positions"][0]
    assert first["stage1_by_the_glass_mm"] == pytest.approx(0.0, abs=0.01)
    assert not next(check for check in content["checks"] if check["name"] == "stage positions")["passed"]


def test_a_model_that_does_not_describe_the_rig_is_refused_or_marked(rig_chain, tmp_path):
    library, record = rig_chain.runs.library, rig_chain.folders["measure"].record()
    strict = {**record.recipe, "max_chi2": 1 + 1e-9}
    path = rig_chain.folders["calibrate-geometry"].results.path("calibration.json")
    original = path.read_text()
    content = json.loads(original)
    content["rig_model"]["chi2_per_dof"] = 5.5
    try:
        path.write_text(json.dumps(content))
        with pytest.raises(Refused, match=r"chi2 5\.5 a degree of freedom, the recipe allows 1"):
            check_uses(record.model_copy(update={"recipe": strict}), library)
        # The paper's equation does not use the model.
        assert check_uses(record.model_copy(update={"recipe": {**strict, "method": "depth-equation"}}), library)
        other = {"optics": Optics(camera_serial="XM-0002", size_px=(SIZE_PX, SIZE_PX))}
        marked = {"recipe": {**strict, "if_calibration_is_off": "mark", "method": "triangulation", "compare": []}}
        assert check_uses(record.model_copy(update=other | marked), library)
        folder = again(rig_chain, tmp_path / "run", **marked["recipe"])
        folder.amend(**other)
        done = process(folder, library, lambda _: None)
    finally:
        path.write_text(original)
    told = folder.results.read_json("result.json")
    assert "made with camera XM-0001, this is XM-0002" in "; ".join(told["calibration"]["off"])
    assert "chi2 5.5" in str(done.summary["calibration_is_off"])
    assert {check["name"]: check["passed"] for check in told["checks"]}["calibration"] is False


def test_without_a_rig_model_the_ray_methods_are_refused(chain):
    record = chain.folders["measure"].record()
    for method in ("triangulation", "generalised", "facets"):
        with pytest.raises(Refused, match=f"has no rig model, which {method} needs: take it at several positions"):
            check_uses(record.model_copy(update={"recipe": {"method": method}}), chain.runs.library)
    with pytest.raises(Refused, match="the depth equation takes two positions"):
        check_uses(record.model_copy(update={"positions_mm": (0.0, 20.0, 40.0)}), chain.runs.library)


def test_a_damaged_rig_model_is_refused(rig_chain, tmp_path):
    path = rig_chain.folders["calibrate-geometry"].results.path("rig_variations.json")
    original = path.read_text()
    try:
        for text in ("{}", '{"models": [{}]}'):
            path.write_text(text)
            with pytest.raises(Refused, match="a calibration or reference is damaged"):
                process(again(rig_chain, tmp_path / str(len(text))), rig_chain.runs.library, lambda _: None)
    finally:
        path.write_text(original)
