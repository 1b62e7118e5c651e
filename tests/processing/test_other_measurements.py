"""Measurements that are not the paper's: a dark tread, three positions, a long baseline, fringes along y."""

import shutil

import numpy as np
import pytest
import tifffile
from simulated_runs import NOMINAL_MM, SimulatedRuns

from irpmd_rig.processing.process import process
from irpmd_rig.store import Store
from sims.rig import SimulatedRig

pytestmark = pytest.mark.timeout(600)
SIGMAS = 4
LOWEST_MM = -9.0
"""Below this lies the first tread of mirror_step_y alone."""


@pytest.fixture
def runs(rig_chain, tmp_path):
    """A store of its own with the calibrations of the rig."""
    root = tmp_path / "data"
    shutil.copytree(rig_chain.runs.store.root, root)
    return SimulatedRuns(Store(root), SimulatedRig(rig_chain.runs.rig.world, seed=11))


def computed(runs, text, change=lambda _: None):
    folder = runs.take(text)
    change(folder)
    process(folder, runs.library, lambda _: None)
    if folder.record().kind == "measure":
        return folder.results.read_json("result.json")
    runs.succeeded(folder)
    return folder.results.read_json("calibration.json")


def measured(runs, *, subject="mirror_step_y", change=lambda _: None, **keys):
    text = f"{{kind: measure, name: another, object: {subject}, max_chi2: 10"
    return computed(runs, text + "".join(f", {key}: {value}" for key, value in keys.items()) + "}", change)


def within_uncertainty(steps, true_mm):
    assert len(steps) == len(true_mm)
    for step, true in zip(steps, true_mm, strict=True):
        assert abs(step["measured_mm"] - true) < SIGMAS * step["uncertainty_um"] / 1e3


def checks(content):
    return {check["name"]: check for check in content["checks"]}


@pytest.fixture(scope="module")
def first_tread(rig_chain):
    """Rows of the picture that show the first tread."""
    depth = rig_chain.folders["measure"].results.read_array("depth_mm.npy")
    rows = np.nonzero((depth < LOWEST_MM).sum(axis=1) > 5)[0]
    return slice(int(rows.min()) - 3, int(rows.max()) + 4)


def dark_in(rows, *stations):
    """Take the light from some rows of the frames of some stations."""

    def change(folder):
        for entry in folder.frames(role="fringes"):
            if entry.station in stations:
                frame = folder.read_frame(entry).copy()
                frame[rows] = 3
                tifffile.imwrite(folder.path / entry.path, frame)

    return change


def test_a_tread_that_is_dark_at_one_of_two_positions_is_said(runs, first_tread):
    content = measured(runs, change=dark_in(first_tread, 1), compare="[depth-equation]")
    within_uncertainty(content["steps"], NOMINAL_MM[1:])
    assert not checks(content)["seen at two positions"]["passed"]
    assert "near x 28 mm, y -27 mm) show fringes at 0 mm only" in checks(content)["seen at two positions"]["says"]
    (patch,) = content["seen_at_one_position"]
    assert patch["seen_at_mm"] == 0
    assert patch["pixels"] > 300
    rows = range(first_tread.start, first_tread.stop)
    assert patch["rows"][0] in rows
    assert patch["rows"][1] - 1 in rows


def test_a_tread_that_is_dark_at_one_of_three_positions_is_measured_from_the_others(runs, first_tread):
    content = measured(runs, change=dark_in(first_tread, 2), positions_mm="[-40, 0, 40]")
    within_uncertainty(content["steps"], NOMINAL_MM)
    assert checks(content)["seen at two positions"]["passed"]
    assert "mm only 0% of its pixels show a phase" in checks(content)["remarks"]["says"]


def test_three_positions_tell_more_than_two(runs, rig_chain):
    three = measured(runs, positions_mm="[-40, 0, 40]")
    within_uncertainty(three["steps"], NOMINAL_MM)
    assert [position["stage1_mm"] for position in three["positions"]] == [-40, 0, 40]
    assert all(check["passed"] for check in three["checks"])
    two = rig_chain.content("measure")
    assert all(a["random_um"] < 0.8 * b["random_um"] for a, b in zip(three["steps"], two["steps"], strict=True))


def test_eight_steps_and_unequal_ways_toward_and_away(runs):
    """As the recipe `precise-measure`; every method has its reference at these positions."""
    fringes = "fringes: {counts: [64, 63, 56], steps: 8}, positions_mm: [-60, 40]"
    computed(runs, f"{{kind: reference, name: reference, {fringes}}}")
    text = f"{{kind: measure, name: precise, object: mirror_step_y, max_chi2: 10, {fringes}, "
    content = computed(runs, text + "compare: [triangulation, generalised, depth-equation]}")
    assert content["not_computed"] == {}
    for method in content["methods"].values():
        within_uncertainty(method["steps"], NOMINAL_MM)
    assert content["delta_d_mm"] == pytest.approx(100, abs=0.01)
    assert max(step["random_um"] for step in content["steps"]) < 3


def test_fringes_along_y_as_well(runs):
    fringes = "fringes: {orientations: [x, y]}"
    without = measured(runs, fringes="{orientations: [x, y]}")
    within_uncertainty(without["steps"], NOMINAL_MM)
    assert checks(without)["fringes along y"]["says"].startswith("not used: the rig model does not hold")
    geometry = computed(runs, f"{{kind: calibrate-geometry, name: rig, positions_mm: [0, -60, 40], {fringes}}}")
    assert geometry["rig_model"]["along_y"]
    reference = computed(runs, f"{{kind: reference, name: reference, {fringes}}}")
    assert reference["positions_mm"] == [0, 40]
    text = f"{{kind: measure, name: both, object: mirror_step_y, max_chi2: 10, {fringes}, "
    content = computed(runs, text + "compare: [triangulation, generalised, depth-equation]}")
    assert content["orientations"] == ["x", "y"]
    assert content["not_computed"] == {}
    for method in content["methods"].values():
        within_uncertainty(method["steps"], NOMINAL_MM)


def test_curved_mirrors_whose_fringes_so_few_pixels_cannot_show_are_not_guessed(runs):
    content = measured(runs, subject="freeform")
    assert content["steps"] == []
    assert content["without_steps"]
    assert not all(check["passed"] for check in content["checks"])
