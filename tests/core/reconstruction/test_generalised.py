"""The generalised depth equation: as exact as triangulation, from a reference instead of the intrinsics."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.errors import FramesError
from irpmd_rig.core.reconstruction.generalised import generalised_depth
from irpmd_rig.core.reconstruction.triangulation import rig_tables, triangulate
from tests.core.reconstruction.traced_views import SIGMA_RAD, cut, rig_of, seen, world_of

SIZE_PX = 256


@pytest.mark.parametrize("name", ["ideal", "misaligned", "turned", "mirrored"])
@pytest.mark.parametrize("positions_mm", [(0.0, 40.0), (0.0, -60.0), (-60.0, 0.0, 40.0)])
def test_exact_for_treads_in_every_rig(name, positions_mm):
    world = world_of(name)
    scene, mirror = (seen(world, subject, positions_mm, SIZE_PX) for subject in ("mirror_step_x", "mirror"))
    errors = scene.errors_um(generalised_depth(scene.views, mirror.views, rig_of(world, SIZE_PX)).depth_mm)
    assert errors.size > 1000
    assert np.abs(errors).max() < 1e-3


def test_tilted_treads_and_freeform_mirrors_are_as_triangulated():
    world = world_of("misaligned")
    tables = rig_tables(rig_of(world, SIZE_PX), np.float64)
    mirror = seen(world, "mirror", (0.0, 40.0), SIZE_PX)
    for subject in ("mirror_step_tilted", "freeform"):
        scene = seen(world, subject, (0.0, 40.0), SIZE_PX)
        generalised = generalised_depth(scene.views, mirror.views, tables.model, tables=tables)
        triangulated = triangulate(scene.views, tables.model, tables=tables)
        assert np.nanmax(np.abs(generalised.depth_mm - triangulated.depth_mm)) < 2e-4


def test_wrong_intrinsics_do_not_matter():
    world = world_of("misaligned")
    model = rig_of(world, SIZE_PX)
    wrong = replace(model, intrinsics=replace(model.intrinsics, distortion=(-0.1, 0.0, 0.001, 0.001, 0.0)))
    scene, mirror = (seen(world, subject, (0.0, 40.0), SIZE_PX) for subject in ("mirror_step_y", "mirror"))
    errors = scene.errors_um(generalised_depth(scene.views, mirror.views, wrong).depth_mm)
    assert np.abs(errors).max() < 2.0
    assert np.abs(scene.errors_um(triangulate(scene.views, wrong).depth_mm)).max() > 50.0


def test_its_sigma_is_the_scatter():
    world = world_of("misaligned")
    tables = rig_tables(rig_of(world, SIZE_PX), np.float64)
    pulls = []
    for seed in range(4):
        scene = seen(world, "mirror_step_y", (0.0, 40.0), SIZE_PX, sigma_rad=SIGMA_RAD, seed=seed)
        mirror = seen(world, "mirror", (0.0, 40.0), SIZE_PX, sigma_rad=SIGMA_RAD, seed=100 + seed)
        found = generalised_depth(scene.views, mirror.views, tables.model, tables=tables)
        pulls.append((found.depth_mm - scene.depth_mm) / found.sigma_mm)
    assert np.nanstd(pulls) == pytest.approx(1.0, abs=0.03)


def test_a_reference_of_another_window_is_refused():
    world = world_of("ideal")
    scene = seen(world, "mirror", (0.0, 40.0), 64)
    part = cut(scene.views, slice(0, 32), slice(0, 64))
    with pytest.raises(FramesError, match="one window"):
        generalised_depth(part, scene.views, rig_of(world, 64))


def test_phases_that_point_beyond_the_lit_glass_have_no_depth():
    world = world_of("misaligned")
    scene = seen(world, "mirror_step_y", (0.0, 40.0), SIZE_PX)
    mirror = seen(world, "mirror", (0.0, 40.0), SIZE_PX)
    rng = np.random.default_rng(1)
    wild = rng.random((SIZE_PX, SIZE_PX)) < 0.05
    phases = [np.where(wild, rng.uniform(0.0, 2 * np.pi * 64, wild.shape), phase) for phase in scene.views.phases_rad]
    views = replace(scene.views, phases_rad=tuple(phases))
    found = generalised_depth(views, mirror.views, rig_of(world, SIZE_PX))
    true = np.isfinite(scene.depth_mm)
    assert np.isnan(found.depth_mm[true & wild]).any()
    assert np.nanmax(found.sigma_mm) < 1e3
