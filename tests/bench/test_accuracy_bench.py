"""The accuracy bench: worlds drawn from a seed, runs taken in them, figures beside the truth."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from irpmd_rig.bench import accuracy
from irpmd_rig.bench.accuracy_core import absolute_phase, depth_law_error_mm
from irpmd_rig.bench.accuracy_lab import Lab
from irpmd_rig.bench.accuracy_plan import CASES, Plan, Task
from irpmd_rig.bench.accuracy_rows import Calibration, Measurement, calibration_rows, row, step_rows, uncertainty_rows
from irpmd_rig.bench.accuracy_truth import Compared, Truth, ask_truth, compare
from irpmd_rig.bench.accuracy_worlds import Change, rig_facts, write_world
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.recipes.plan import plan
from irpmd_rig.recipes.reading import read_recipe
from sims.world import load_world


def found(errors_um, sigmas_um=None, **more):
    """What one method found, with everything that a test does not say unknown."""
    nothing = dict.fromkeys(("step_chi2", "pixel_um", "shape_um", "absolute_um", "pixel_chi2"), np.nan)
    sigmas_um = sigmas_um or (1.0,) * len(errors_um)
    return Compared(tuple(errors_um), tuple(sigmas_um), **(nothing | {"pistons_um": ()} | more))


def measurement(case, seed, subject, *errors_um):
    return Measurement(case, seed, subject, "facets", {"facets": found(errors_um), "depth-equation": found([30.0])})


@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("change", [Change(), Change(bow_um=20.0), Change(warped=True), Change(read_noise=2.0)])
def test_worlds_are_misaligned_by_the_stated_sizes(tmp_path, seed, change):
    write_world(tmp_path / "world.yaml", seed, change)
    world = load_world(tmp_path / "world.yaml")
    glass, stage, projector = world.glass, world.stage1, world.projector
    assert np.hypot(glass.tilt_about_x_deg, glass.tilt_about_y_deg) == pytest.approx(0.1)
    assert np.hypot(stage.axis_tilt_about_x_deg, stage.axis_tilt_about_y_deg) == pytest.approx(0.1)
    assert np.hypot(projector.tilt_about_x_deg, projector.tilt_about_y_deg) == pytest.approx(1.0)
    half = projector.size_px[0] / 2 * projector.pixel_um * 1e-3 / projector.focal_mm
    assert abs(projector.distortion[0]) * half**2 == pytest.approx(0.003, rel=1e-3)
    assert (stage.position_noise_um, projector.gamma, world.camera.psf_px, world.camera.bits) == (1.0, 1.05, 0.7, 8)
    assert glass.bow_um == change.bow_um
    assert projector.warp_amplitude_px == (0.256 if change.warped else 0.0)
    assert world.camera.read_noise_e == 13.0 * change.read_noise


def test_axes_and_signs_are_the_seeds(tmp_path):
    worlds = [write_world(tmp_path / "world.yaml", seed, Change()) for seed in range(1, 6)]
    assert worlds[0] == write_world(tmp_path / "world.yaml", 1, Change())
    about_y = [world["stage1"]["axis_tilt_about_y_deg"] for world in worlds]
    assert min(about_y) < 0 < max(about_y)
    assert {np.sign(world["projector"]["distortion"][0]) for world in worlds} == {-1.0, 1.0}


def test_every_recipe_of_a_plan_holds_and_calibrations_come_first(tmp_path):
    tasks = list(Plan(3, tmp_path).tasks(CASES))
    kinds = [read_recipe(task.recipe)[0].kind for task in tasks]
    assert kinds[:4] == ["calibrate-camera", "calibrate-plate", "calibrate-geometry", "reference"]
    assert {task.case for task in tasks if task.subject} == {
        "paper", "precise", "freeform, paper", "freeform, precise", "noise", "bow", "warp",
    }  # fmt: skip
    assert len({task.noise_seed for task in tasks}) == len(tasks)
    assert sum(plan(read_recipe(task.recipe)[0]).frames for task in tasks) < 1800
    # Another projector needs a plate of its own; another glass does not.
    plates = [task.world.name for task, kind in zip(tasks, kinds, strict=True) if kind == "calibrate-plate"]
    assert plates == ["base-3.yaml", "warp-3.yaml"]


def test_a_sweep_tilts_the_stage_alone(tmp_path):
    tasks = list(Plan(2, tmp_path).tilted((0.0, 0.5), "mirror_step_y"))
    assert [task.stage_tilt_deg for task in tasks if task.subject] == [0.0, 0.5]
    first, second = (load_world(task.world) for task in tasks if task.subject)
    assert (first.stage1.axis_tilt_about_y_deg, second.stage1.axis_tilt_about_y_deg) == (0.0, 0.5)
    assert first.glass == second.glass
    assert first.projector == second.projector


def test_the_lab_takes_and_computes_a_run(tmp_path):
    path = tmp_path / "world.yaml"
    rig = rig_facts(write_world(path, 1, Change()))
    task = Task("kind: calibrate-camera\nname: camera\nposes: 6\n", path, rig, 11, "calibration", 1)
    again = Task("kind: calibrate-camera\nname: camera\nposes: 6\n", path, rig, 12, "calibration", 1)
    ((given, done), (_, other)) = Lab(tmp_path, 384, 1).carry_out([task, again])
    truth = ask_truth(path, "mirror_step_y", 384, tmp_path)
    assert given is task
    assert done.content["intrinsics"]["focal_px"][0] == pytest.approx(truth.focal_px[0], abs=3)
    assert done.content["intrinsics"]["focal_px"] != other.content["intrinsics"]["focal_px"]
    assert not (done.folder.path / "frames").exists()
    assert not list(tmp_path.glob("rendered-*"))
    assert truth.d_mm == 180.0
    assert len(truth.facets) == len(truth.steps_mm) + 1 == 5


def test_a_recipe_s_led_lights_the_run(tmp_path):
    path = tmp_path / "world.yaml"
    rig = rig_facts(write_world(path, 1, Change()))
    exposures_us = []
    for light in ("", "light: {led: green, intensity: 0.6}\n"):
        recipe = f"kind: reference\nname: reference\n{light}"
        rendered = Lab(tmp_path, 64, 1)._render(Task(recipe, path, rig, 11, "paper", 1))
        taken = json.loads((rendered / "frames" / "frames.json").read_text())["stations"]
        exposures_us.append(taken[0]["exposure_us"])
        shutil.rmtree(rendered)
    infrared, visible = exposures_us
    assert visible < 0.6 * infrared  # ambient light and a more sensitive camera: metered, it does not saturate


def test_the_simulator_s_complaint_is_passed_on(tmp_path):
    (tmp_path / "world.yaml").write_text("seed: 1\n")
    with pytest.raises(MeasurementError, match=r"world.yaml:1:1: camera: is missing"):
        ask_truth(tmp_path / "world.yaml", "mirror_step_y", 256, tmp_path)


def test_results_are_set_beside_the_truth(tmp_path):
    z_mm = np.zeros((40, 80))
    z_mm[:, 40:] = 3.0
    left, right = np.zeros((2, 40, 80), bool)
    left[5:35, 5:35] = right[5:35, 45:75] = True
    truth = Truth(z_mm, (left, right), (3.0,), 180.0, (1.0, 1.0))
    noise = np.random.default_rng(0).normal(0, 2e-3, z_mm.shape)
    depth_mm = z_mm + noise + np.where(left, 5e-3, 7e-3)
    np.save(tmp_path / "depth.npy", depth_mm.astype(np.float32))
    np.save(tmp_path / "sigma.npy", np.full(z_mm.shape, 2e-3, np.float32))
    content = {
        "methods": {
            "facets": {
                "steps": [{"measured_mm": 3.002, "uncertainty_um": 4.0}],
                "step_covariance_um2": [[16.0]],
                "depth_file": "depth.npy",
                "sigma_file": "sigma.npy",
            },
            "triangulation": {"steps": [], "depth_file": None},
        }
    }
    done = SimpleNamespace(
        content=content, folder=SimpleNamespace(results=SimpleNamespace(path=Path(tmp_path).joinpath))
    )
    facets = compare(done, truth)["facets"]
    assert facets.step_errors_um == pytest.approx((2.0,))
    assert facets.step_chi2 == pytest.approx(0.25)
    assert facets.gap_um == pytest.approx(2.0, abs=0.3)
    assert facets.shape_um == pytest.approx(2.0, rel=0.05)
    assert facets.pixel_um == pytest.approx(np.hypot(2.0, 1.0), rel=0.05)
    assert facets.absolute_um == pytest.approx(np.sqrt(4 + (25 + 49) / 2), rel=0.05)
    assert facets.pixel_chi2 == pytest.approx(1.25, abs=0.1)
    missed = compare(done, truth)["triangulation"]
    assert missed.largest_step_um == np.inf
    assert np.isnan(missed.gap_um)


def test_a_row_has_worst_and_median_and_hides_nothing():
    assert (row("x", "um", [-3.0, 1.0, 2.0]).worst, row("x", "um", [-3.0, 1.0, 2.0]).median) == (3.0, 2.0)
    missed = row("x", "um", [1.0, np.inf, 2.0])
    assert (missed.worst, missed.median, missed.count) == (None, 2.0, 3)


def test_steps_are_gathered_over_seeds_and_tables():
    taken = [
        measurement("paper", 1, "mirror_step_y", 1.0, -2.0),
        measurement("paper", 2, "fan_y", 0.5, 0.1),
        measurement("paper", 1, "mirror_step_x", 3.0),
        measurement("paper", 2, "mirror_step_x"),
    ]
    rows = {row.name.split(",")[0] + row.name[-1]: row for row in step_rows(taken)}
    along_y, along_x = (rows[f"default method: largest step error{axis}"] for axis in "yx")
    assert (along_y.worst, along_y.median, along_y.must, along_y.aim) == (2.0, 1.25, 2.5, 1.0)
    assert (along_x.worst, along_x.note) == (None, "all facets found in 1 of 2 only")
    assert rows["depth-equation: largest step errory"].worst == 30.0


def test_stated_uncertainties_are_held_to_the_errors():
    taken = [measurement("paper", 1, "mirror_step_y", 1.0, -2.0), measurement("paper", 2, "fan_y", 0.0, 1.0)]
    (chi2,) = uncertainty_rows(taken)
    assert (chi2.worst, chi2.median, chi2.count) == (2.5, 1.5, 2)


def test_calibrations_have_rows_and_the_free_form_is_told():
    rows = calibration_rows([Calibration("bow", 1, 0.05, -3.0, 130.0, 1.0, 1.2, True)])
    assert [r.worst for r in rows] == [0.05, 3.0, 130.0, 1.0, 1.2]
    assert rows[-1].note == "free-form correction used in 1 of 1"


def test_the_depth_equation_is_exact_where_it_claims_to_be():
    assert depth_law_error_mm() < 1e-9


def test_absolute_phase_is_right_over_all_columns():
    rms_rad, wrong = absolute_phase(1, 1024)
    assert rms_rad < 0.0070
    assert wrong == 0


def test_unknown_cases_and_sweeps_are_refused():
    with pytest.raises(MeasurementError, match="there is no case sleep"):
        accuracy.run(cases=("sleep",))
    with pytest.raises(MeasurementError, match="there is no sweep 'glass'"):
        accuracy.run(sweep="glass")
