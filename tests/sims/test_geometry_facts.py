"""The shipped geometry is the one in which every step of the paper is possible (physics notes, section 2)."""

import numpy as np
import pytest

from sims.optics import trace
from sims.setup import Setup
from sims.world import World

# Counts are taken with a quarter of the camera's columns and rows.
FULL = 16


@pytest.fixture(scope="module")
def world(aligned: World) -> World:
    return aligned.with_camera_size(512)


def z_camera(world: World, points: np.ndarray) -> np.ndarray:
    return (points - np.array(world.camera.position_mm)) @ np.array(world.camera.axis)


def test_sprayed_part_is_lit_past_the_edge_of_the_glass(world: World) -> None:
    for stage1_mm in (0.0, 40.0, -60.0):
        seen = trace(world, Setup("mirror", stage1_mm=stage1_mm))
        lit = (seen.kind == 2) & (seen.projector_factor_per_mm2 > 0)
        assert FULL * lit.sum() == pytest.approx(305_000, rel=0.01)
        depths = z_camera(world, seen.point_mm[lit])
        assert depths.min() == pytest.approx(324, abs=1)
        assert depths.max() == pytest.approx(352, abs=1)


def test_glass_is_seen_directly_from_its_edge_on(world: World) -> None:
    seen = trace(world, Setup("mirror"))
    glass = seen.point_mm[seen.kind == 3]
    assert glass[:, 0].min() == pytest.approx(0, abs=0.5)
    assert 110 < glass[:, 0].max() < 116
    depths = z_camera(world, glass)
    assert depths.min() == pytest.approx(216, abs=1)
    assert depths.max() == pytest.approx(284, abs=1.5)
    near = trace(world, Setup("mirror", stage1_mm=-80.0))
    assert near.point_mm[near.kind == 3][:, 0].max() == pytest.approx(250, abs=1)
    far = trace(world, Setup("mirror", stage1_mm=40.0))
    assert far.point_mm[far.kind == 3][:, 0].max() == pytest.approx(41, abs=1)


@pytest.mark.parametrize("stage1_mm", [0.0, 40.0])
def test_reflected_glass_is_seen_in_the_whole_mirror(world: World, stage1_mm: float) -> None:
    bare = world.mirror.model_copy(update={"sprayed_x_mm": None, "y_mm": (-90.0, 90.0)})
    seen = trace(world.model_copy(update={"mirror": bare}), Setup("mirror", stage1_mm=stage1_mm))
    points = seen.point_mm[(seen.kind == 1) & np.isfinite(seen.projector_px[..., 0])]
    assert points[:, 0].min() < -56
    assert points[:, 0].max() > 84
    assert points[:, 1].min() < -74
    assert points[:, 1].max() > 74


def test_plate_is_lit_at_all_positions_where_the_sprayed_part_is_seen(world: World) -> None:
    mirror = trace(world, Setup("mirror"))
    lit = np.stack(
        [trace(world, Setup("plate", glass=False, stage2_mm=10.0 * n)).projector_factor_per_mm2 > 0 for n in range(21)]
    ).sum(axis=0)
    assert lit[mirror.kind == 2].min() == 21
    assert lit[mirror.kind == 3].min() >= 10
    assert np.median(lit[mirror.kind == 3]) == 21


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("mirror_step_y", 31_000, 36_500),
        ("mirror_step_x", 22_500, 36_000),
        ("fan_y", 18_000, 30_000),
        ("fan_x", 12_000, 24_000),
    ],
)
def test_facets_have_enough_usable_pixels(world: World, name: str, low: int, high: int) -> None:
    seen = [trace(world, Setup(name, stage1_mm=s)) for s in (0.0, 40.0)]
    usable = (seen[0].projector_factor_per_mm2 > 0) & (seen[1].projector_factor_per_mm2 > 0) & (seen[0].kind == 1)
    counts = [FULL * int((usable & (seen[0].facet == k)).sum()) for k in range(seen[0].facet.max() + 1)]
    assert low <= min(counts)
    assert max(counts) <= high


def test_all_of_the_freeform_mirrors_sees_the_glass_at_every_position(world: World) -> None:
    for stage1_mm in (-60.0, -30.0, 0.0, 40.0):
        seen = trace(world, Setup("freeform", stage1_mm=stage1_mm))
        assert np.all(np.isfinite(seen.projector_px[seen.kind == 1]))


def test_walls_shade_a_strip_as_wide_as_the_reflected_ray_is_slanted(world: World) -> None:
    """Rising along x, a wall hides nothing from the camera but shades h tan(theta) of the tread before it."""
    seen = trace(world.with_camera_size(1024), Setup("mirror_step_x"))
    eye = np.array(world.camera.position_mm)
    steps = (3.9868, 7.0248, 5.0062, 6.0986)
    centre_row = np.abs(seen.point_mm[..., 1]) < 1
    for facet, step in enumerate(steps):
        on_facet = centre_row & (seen.facet == facet)
        edge = 72 / 5 * (facet + 1)
        shaded = seen.point_mm[on_facet & ~(seen.projector_factor_per_mm2 > 0)]
        width = edge - shaded[:, 0].min()
        x, z = shaded[:, 0].min(), shaded[0, 2]
        assert width == pytest.approx(step * (x - eye[0]) / (eye[2] - z), abs=0.45)
        assert 1.5 < width < 6


def test_falling_along_x_the_walls_hide_what_is_behind_them(world: World) -> None:
    falling = world.objects["mirror_step_x"].model_copy(update={"rising": "negative"})
    turned = world.model_copy(update={"objects": {"step": falling}}).with_camera_size(1024)
    seen = trace(turned, Setup("step"))
    lit = (seen.kind == 1) & (seen.projector_factor_per_mm2 > 0)
    assert lit.sum() == (seen.kind == 1).sum()
    # Facet 3 lies behind the highest one, facet 4, and its wall of 6.0986 mm.
    second = seen.point_mm[(seen.facet == 3) & (np.abs(seen.point_mm[..., 1]) < 1)]
    x, z = second[:, 0].min(), second[0, 2]
    assert x - 72 / 5 == pytest.approx(6.0986 * (x + 160) / (330 - z), abs=0.4)


def test_glass_hides_what_is_behind_it_and_keeps_the_projector_from_it(world: World) -> None:
    bare = trace(world, Setup("plate", glass=False, stage2_mm=150.0))
    covered = trace(world, Setup("plate", stage2_mm=150.0))
    hidden = (bare.kind == 2) & (covered.kind == 3)
    assert hidden.sum() > 10_000
    assert np.all(covered.point_mm[hidden][:, 2] == pytest.approx(180.0))
    both = (bare.kind == 2) & (covered.kind == 2)
    unlit = both & (bare.projector_factor_per_mm2 > 0) & (covered.projector_factor_per_mm2 == 0)
    assert unlit.sum() > 1_000
    # In the shade of the glass: the way to the projector crosses it.
    point, source = covered.point_mm[unlit], np.array(world.projector.position_mm)
    crossing = point + (source - point) * ((180.0 - point[:, 2]) / (1850.0 - point[:, 2]))[:, None]
    assert crossing[:, 0].min() >= 0
    assert np.abs(crossing[:, 1]).max() <= 125
