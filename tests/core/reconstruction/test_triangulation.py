"""Triangulation: exact on exact phases in every rig, honest about what it cannot know, and about its noise."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core.errors import CalibrationError, FramesError, MeasurementError
from irpmd_rig.core.reconstruction.triangulation import rig_tables, triangulate
from irpmd_rig.core.reconstruction.views import Views
from irpmd_rig.core.rig_model import Correction
from tests.core.reconstruction.traced_views import SIGMA_RAD, cut, rig_of, seen, world_of

SIZE_PX = 256
OBJECTS = ("mirror_step_x", "mirror_step_tilted", "fan_y", "freeform")
WORLDS = ("ideal", "misaligned", "turned", "mirrored")
# A level tread by x fringes, and everything by x and y fringes, is exact but for float32 of the result.
EXACT_UM = 1e-3


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("positions_mm", [(0.0, 40.0), (0.0, -60.0), (-60.0, -10.0, 40.0)])
def test_level_treads_are_exact_in_every_rig_away_and_toward(name, positions_mm):
    world = world_of(name)
    scene = seen(world, "mirror_step_x", positions_mm, SIZE_PX)
    depth = triangulate(scene.views, rig_of(world, SIZE_PX))
    errors = scene.errors_um(depth.depth_mm)
    assert errors.size == np.isfinite(scene.depth_mm).sum() > 1000
    assert np.abs(errors).max() < EXACT_UM
    assert np.nanmax(np.abs(depth.slope_x - scene.slope_x)) < 1e-6


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("subject", OBJECTS)
def test_with_y_fringes_any_surface_is_exact_and_its_slopes_are_measured(name, subject):
    world = world_of(name)
    scene = seen(world, subject, (0.0, 40.0), SIZE_PX, y=True)
    depth = triangulate(scene.views, rig_of(world, SIZE_PX))
    assert np.abs(scene.errors_um(depth.depth_mm)).max() < EXACT_UM
    for found, true in ((depth.slope_x, scene.slope_x), (depth.slope_y, scene.slope_y)):
        assert np.nanmax(np.abs(found - true)) < 1e-6


@pytest.mark.parametrize("name", WORLDS[1:])
def test_x_fringes_alone_are_right_on_tilted_treads_once_the_slope_across_is_known(name):
    world = world_of(name)
    model = rig_of(world, 512)
    scene = seen(world, "mirror_step_tilted", (0.0, 40.0), 512)
    level = scene.errors_um(triangulate(scene.views, model, slope_rounds=0).depth_mm)
    found = triangulate(scene.views, model)
    assert np.abs(level).max() > 4.0
    assert np.sqrt(np.mean(scene.errors_um(found.depth_mm) ** 2)) < 0.1
    for facet in range(5):
        of_facet = scene.facet == facet
        assert abs(np.nanmean(found.depth_mm[of_facet] - scene.depth_mm[of_facet])) < 1e-5


@pytest.mark.parametrize(("rounds", "rms_um"), [(1, 3.0), (2, 0.6), (3, 0.3)])
def test_each_round_brings_a_sphere_and_a_saddle_nearer(rounds, rms_um):
    world = world_of("turned")
    scene = seen(world, "freeform", (0.0, 40.0), 512)
    model = rig_of(world, 512)
    level = scene.errors_um(triangulate(scene.views, model, slope_rounds=0).depth_mm)
    assert np.sqrt(np.mean(level**2)) > 15
    found = triangulate(scene.views, model, slope_rounds=rounds)
    assert np.sqrt(np.mean(scene.errors_um(found.depth_mm) ** 2)) < rms_um


@pytest.mark.parametrize(("subject", "y"), [("mirror_step_tilted", False), ("freeform", False), ("freeform", True)])
@pytest.mark.parametrize("positions_mm", [(0.0, 40.0), (-60.0, 0.0, 40.0)])
def test_sigma_is_the_scatter_of_repetitions(subject, y, positions_mm):
    world = world_of("misaligned")
    tables = rig_tables(rig_of(world, SIZE_PX), np.float64)
    depths, sigmas = [], []
    for seed in range(24):
        scene = seen(world, subject, positions_mm, SIZE_PX, sigma_rad=SIGMA_RAD, y=y, seed=seed)
        found = triangulate(scene.views, tables.model, tables=tables, slope_rounds=0 if not y else 1)
        depths.append(found.depth_mm)
        sigmas.append(found.sigma_mm)
    scatter = np.std(depths, axis=0, ddof=1)
    sigma = np.mean(sigmas, axis=0)
    known = np.isfinite(scatter)
    assert 0.02 < np.median(sigma[known]) < 0.12
    # 24 repetitions of some thousand pixels tell the ratio to half a percent.
    assert np.sqrt(np.mean((scatter[known] / sigma[known]) ** 2)) == pytest.approx(1.0, abs=0.02)


def test_sigma_follows_the_noise_of_the_pixel_and_of_the_view():
    world = world_of("misaligned")
    model = rig_of(world, SIZE_PX)
    scene = seen(world, "mirror_step_y", (0.0, 40.0), SIZE_PX)
    quiet = triangulate(scene.views, model).sigma_mm
    first, second = scene.views.sigmas_rad
    loud = triangulate(replace(scene.views, sigmas_rad=(first, 2 * second)), model).sigma_mm
    near, far = 180.0, 220.0
    ratio = np.sqrt((far**2 + 4 * near**2) / (far**2 + near**2))
    assert np.nanmedian(loud / quiet) == pytest.approx(ratio, rel=0.02)


def test_float32_phases_cost_a_tenth_of_a_micrometre():
    world = world_of("mirrored")
    model = rig_of(world, SIZE_PX)
    exact, single = (
        triangulate(seen(world, "fan_y", (-60.0, 40.0), SIZE_PX, kind=kind).views, model).depth_mm
        for kind in (np.float64, np.float32)
    )
    difference = (single - exact)[np.isfinite(exact)]
    assert np.isfinite(difference).all()
    assert difference.std() < 1e-4
    assert abs(difference.mean()) < 2e-5


def test_a_pixel_needs_two_views_and_takes_all_that_it_has():
    world = world_of("misaligned")
    model = rig_of(world, SIZE_PX)
    scene = seen(world, "mirror_step_y", (-60.0, 0.0, 40.0), SIZE_PX)
    first, second, third = (phase.copy() for phase in scene.views.phases_rad)
    known = np.argwhere(np.isfinite(scene.depth_mm))
    (a, b, c) = (tuple(known[k]) for k in (100, 500, 900))
    first[a] = np.nan
    second[b], third[b] = np.nan, np.nan
    first[c], second[c], third[c] = np.nan, np.nan, np.nan
    depth = triangulate(replace(scene.views, phases_rad=(first, second, third)), model)
    assert depth.depth_mm[a] == pytest.approx(scene.depth_mm[a], abs=1e-6)
    assert np.isnan([depth.depth_mm[b], depth.depth_mm[c], depth.sigma_mm[b], depth.sigma_mm[c]]).all()
    wholly = triangulate(scene.views, model)
    assert depth.sigma_mm[a] > wholly.sigma_mm[a]
    assert np.isnan(wholly.sigma_mm[np.isnan(wholly.depth_mm)]).all()


def test_what_is_behind_the_glass_or_the_camera_or_on_parallel_rays_is_nan():
    world = world_of("ideal")
    model = rig_of(world, SIZE_PX)
    tables = rig_tables(model, np.float64)
    row = column = SIZE_PX // 2
    x, y = (
        float(values[0, 0]) for values in tables.points_mm(np.zeros((1, 1)), np.s_[row : row + 1, column : column + 1])
    )
    ray = tables.rays_x[row, column]

    def depth_at(lit_x_mm):
        points = [np.array([[x_mm, y, 180.0]]) for x_mm in lit_x_mm]
        phases = tuple(model.phase_rad(point, on_glass=True)[None] for point in points)
        window = (slice(row, row + 1), slice(column, column + 1))
        sigmas = tuple(np.full((1, 1), SIGMA_RAD) for _ in phases)
        return triangulate(Views((0.0, 40.0), phases, sigmas, window), model, tables=tables).depth_mm[0, 0]

    # Lines of the slope T through a point of the viewing ray at this height.
    def crossing(height_mm, slope):
        return [x + ray * height_mm + slope * (180.0 + s - height_mm) for s in (0.0, 40.0)]

    assert depth_at(crossing(7.0, -ray)) == pytest.approx(7.0, abs=1e-5)
    assert np.isnan(depth_at(crossing(185.0, -ray)))
    assert np.isnan(depth_at(crossing(340.0, -ray)))
    assert np.isnan(depth_at(crossing(5.0, ray + 2e-4)))


def test_a_window_gives_what_the_whole_picture_gives():
    world = world_of("turned")
    tables = rig_tables(rig_of(world, SIZE_PX))
    scene = seen(world, "mirror_step_y", (0.0, 40.0), SIZE_PX)
    window = np.s_[90:170, 70:201]
    whole = triangulate(scene.views, tables.model, tables=tables, slope_rounds=0)
    part = triangulate(cut(scene.views, *window), tables.model, tables=tables, slope_rounds=0)
    np.testing.assert_array_equal(part.depth_mm, whole.depth_mm[window])
    np.testing.assert_array_equal(part.sigma_mm, whole.sigma_mm[window])


@pytest.mark.parametrize("y", [False, True])
def test_a_bowed_glass_and_a_corrected_phase_are_followed(y):
    world = world_of("turned")
    smooth = np.zeros((4, 4))
    smooth[2, 0], smooth[0, 2], smooth[1, 2], smooth[3, 0] = 0.02, -0.015, 0.01, 0.012
    domain = (-40.0, 190.0), (-100.0, 100.0)
    model = replace(
        rig_of(world, SIZE_PX), bow_mm=Correction(*domain, smooth), correction_rad=Correction(*domain, 3 * smooth.T)
    )
    tables = rig_tables(model, np.float64)
    height = np.full((SIZE_PX, SIZE_PX), 4.0)
    whole = np.s_[0:SIZE_PX, 0:SIZE_PX]
    points = np.stack([*tables.points_mm(height, whole), height], axis=-1)
    seen_along = np.stack([tables.rays_x, tables.rays_y, np.ones_like(height)], axis=-1)
    leaving = seen_along * [-1.0, -1.0, 1.0]
    lit = [model.meet_glass(model.still(points, s), leaving) for s in (0.0, 40.0)]
    # Also beyond the domain, where the edge's value holds.
    on_glass = np.logical_and.reduce([(p[..., 0] > -60) & (p[..., 0] < 210) & (np.abs(p[..., 1]) < 115) for p in lit])
    phases = tuple(np.where(on_glass, model.phase_rad(p, on_glass=True), np.nan) for p in lit)
    phases_y = tuple(np.where(on_glass, model.phase_y_rad(p), np.nan) for p in lit)
    sigmas = tuple(np.full(height.shape, SIGMA_RAD) for _ in lit)
    views = Views((0.0, 40.0), phases, sigmas, whole, phases_y if y else None)
    found = triangulate(views, model, tables=tables)
    assert np.isfinite(found.depth_mm).sum() > 0.9 * on_glass.sum() > 5000
    assert np.nanmax(np.abs(found.depth_mm - height)) < 1.5e-4
    plain = replace(model, bow_mm=None, correction_rad=None)
    assert np.nanmax(np.abs(triangulate(views, plain, tables=replace(tables, model=plain)).depth_mm - height)) > 1e-3


def test_views_that_cannot_be_are_refused():
    phase = np.zeros((4, 5))
    window = (slice(0, 4), slice(0, 5))
    with pytest.raises(MeasurementError, match="two or more different stage positions"):
        Views((0.0, 0.0), (phase, phase), (phase, phase), window)
    with pytest.raises(MeasurementError, match="two or more different stage positions"):
        Views((0.0, np.nan), (phase, phase), (phase, phase), window)
    with pytest.raises(FramesError, match="as many phase and sigma maps"):
        Views((0.0, 40.0), (phase, phase), (phase,), window)
    with pytest.raises(FramesError, match="window's shape"):
        Views((0.0, 40.0), (phase, phase.T), (phase, phase), window)
    model = rig_of(world_of("ideal"), 64)
    beyond = Views((0.0, 40.0), (phase, phase), (phase, phase), (slice(62, 66), slice(0, 5)))
    with pytest.raises(FramesError, match="not within the camera's picture"):
        triangulate(beyond, model)


def test_a_projector_that_does_not_light_the_glass_is_refused():
    model = rig_of(world_of("ideal"), 64)
    away = replace(model, projector=replace(model.projector, axes=model.projector.axes * [[1.0], [1.0], [-1.0]]))
    with pytest.raises(CalibrationError, match="does not shine onto the glass"):
        rig_tables(away)


def test_nothing_known_gives_nothing():
    model = rig_of(world_of("ideal"), 64)
    phase = np.full((64, 64), np.nan)
    depth = triangulate(Views((0.0, 40.0), (phase, phase), (phase, phase), np.s_[0:64, 0:64]), model)
    for values in (depth.depth_mm, depth.sigma_mm, depth.slope_x, depth.slope_y):
        assert np.isnan(values).all()


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_two_views_are_a_special_case_of_more(name, kind):
    """A third view without light changes nothing: the kernel of two views does what the one of many does."""
    world = world_of(name)
    model = rig_of(world, SIZE_PX)
    two = seen(world, "fan_y", (0.0, 40.0), SIZE_PX, sigma_rad=SIGMA_RAD, kind=kind).views
    dark = np.full_like(two.phases_rad[0], np.nan)
    three = Views((*two.positions_mm, 20.0), (*two.phases_rad, dark), (*two.sigmas_rad, two.sigmas_rad[0]), two.window)
    one, other = (triangulate(views, model, slope_rounds=0) for views in (two, three))
    apart_mm = 1e-6 if kind is np.float64 else 2e-3
    np.testing.assert_allclose(one.depth_mm, other.depth_mm, rtol=0, atol=apart_mm)
    np.testing.assert_allclose(one.sigma_mm, other.sigma_mm, rtol=1e-4)


def test_the_slope_of_a_tilted_mirror_is_found_from_a_coarse_picture_as_from_a_fine_one():
    world = world_of("turned")
    for size_px in (160, 320):
        scene = seen(world, "mirror_step_tilted", (0.0, 40.0), size_px)
        found = triangulate(scene.views, rig_of(world, size_px))
        inside = np.isfinite(found.slope_y) & np.isfinite(scene.slope_y)
        assert np.median(np.abs(found.slope_y - scene.slope_y)[inside]) < 2e-5
