"""What a reproduction takes: every recipe holds, and calibrations come before what uses them."""

import numpy as np
import pytest

from irpmd_rig.bench.accuracy_truth import Truth
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.report.shape import Shape
from irpmd_rig.reproduce.recipes import PAPER, VISIBLE, paper_with
from irpmd_rig.reproduce.scheme import COUNTS, FAN, PARTS, READ_NOISE, REPEATS, STEP, TILTS_DEG, Scheme
from irpmd_rig.reproduce.taken import plain_steps
from sims.world import load_world


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    return list(Scheme(3, tmp_path_factory.mktemp("worlds"), PARTS).tasks())


def test_every_recipe_holds_and_calibrations_come_first(tasks):
    kinds = [read_recipe(task.recipe)[0].kind for task in tasks]
    assert kinds[:4] == ["calibrate-camera", "calibrate-plate", "calibrate-geometry", "reference"]
    assert [kind == "measure" for kind in kinds] == [bool(task.subject) for task in tasks]
    assert len({task.noise_seed for task in tasks}) == len(tasks)


def test_the_paper_s_recipe_is_the_paper_s():
    recipe, _ = read_recipe(PAPER.measure(STEP))
    assert (recipe.fringes.counts, recipe.fringes.steps, recipe.positions_mm) == ((64, 63, 56), 4, (0, 40))
    assert (recipe.method, recipe.phase_filter) == ("depth-equation", True)


def test_everything_is_taken_as_often_as_is_said(tasks):
    uses = [task.use for task in tasks]
    assert uses.count("repeat") == REPEATS == 20
    for use, points in (("stage-tilt", TILTS_DEG), ("read-noise", READ_NOISE), ("fringe-count", COUNTS)):
        assert tuple(task.at for task in tasks if task.use == use) == points


def test_visible_light_is_another_led_and_nothing_else(tasks):
    infrared, visible = (next(t for t in tasks if (t.use, t.subject) == (use, FAN)) for use in ("paper", "visible"))
    assert infrared.world == visible.world
    one, other = (read_recipe(task.recipe)[0].model_dump() for task in (infrared, visible))
    assert other["light"]["led"] == VISIBLE
    assert {key for key in one if one[key] != other[key]} == {"light", "name"}
    at = tasks.index(visible)
    assert read_recipe(tasks[at - 1].recipe)[0].light.led == VISIBLE  # its reference is taken in the same light


def test_repetitions_share_calibration_and_recipe(tasks):
    first = next(k for k, task in enumerate(tasks) if task.use == "repeat")
    repeated = tasks[first : first + REPEATS]
    assert {task.use for task in repeated} == {"repeat"}
    assert len({(task.recipe, task.world) for task in repeated}) == 1


def test_a_sweep_changes_one_thing_of_the_world(tasks):
    worlds = [load_world(task.world) for task in tasks if task.use == "stage-tilt"]
    assert [world.stage1.axis_tilt_about_y_deg for world in worlds] == list(TILTS_DEG)
    assert len({world.glass for world in worlds}) == 1
    noises = [load_world(task.world).camera.read_noise_e for task in tasks if task.use == "read-noise"]
    assert noises == [13.0 * factor for factor in READ_NOISE]


@pytest.mark.parametrize("count", COUNTS)
def test_other_fringe_counts_are_optimum_sets(count):
    assert paper_with(count).counts == (count, count - 1, count - int(np.sqrt(count)))


def test_fewer_parts_take_fewer_runs(tmp_path):
    few = list(Scheme(1, tmp_path, ("repeatability",)).tasks())
    assert len(few) == 4 + REPEATS
    assert {task.subject for task in few} == {"", STEP}


def test_plain_planes_are_taken_halfway_between_the_facets():
    x, y = np.meshgrid(np.arange(20.0), np.arange(41.0))
    labels = np.where(y < 20, 1, np.where(y > 20, 2, 0)).astype(np.int32)
    z = np.where(labels == 2, 4.0 + 0.01 * x, 0.02 * y)
    points = np.stack([x, y, z], axis=-1).astype(np.float32)
    shape = Shape(np.s_[:, :], z, None, points, labels, z)
    truth = Truth(z, (), (3.6,), 180.0, (1.0, 1.0))
    # Facets are centred at y = 9.5 and 30.5: halfway is y = 20, x = 9.5.
    step_mm = 4.0 + 0.01 * 9.5 - 0.02 * 20
    found = plain_steps(shape, truth)
    assert found.measured_mm == pytest.approx((step_mm,), abs=1e-5)
    assert found.errors_um == pytest.approx((1e3 * (step_mm - 3.6),), abs=0.01)


def test_plain_planes_of_too_few_facets_are_no_steps():
    points = np.random.default_rng(0).normal(size=(5, 5, 3)).astype(np.float32)
    shape = Shape(np.s_[:, :], points[..., 2], None, points, np.ones((5, 5), np.int32), points[..., 2])
    assert plain_steps(shape, Truth(points, (), (1.0,), 180.0, (1.0, 1.0))).errors_um == ()
