"""The pieces of a measurement that are cut up for speed and memory give what the whole would."""

import numpy as np
import pytest

from irpmd_rig.core import Intrinsics, Plane, RigGeometry, direct_depth, rays, reference_frame
from irpmd_rig.processing.depth import depth_map, windowed
from irpmd_rig.processing.evaluate import evaluate
from irpmd_rig.processing.regions import bounding_box, common, grow, inside, lit, shrink, within

LENS = Intrinsics((400, 300), (460.0, 461.0), (198.0, 151.0), (-0.14, 0.15, -4e-5, -1.6e-4, 0.0))
WINDOW = slice(37, 213), slice(51, 301)


def test_bands_on_two_threads_are_the_depth_equation():
    rng = np.random.default_rng(1)
    phases = [(100 + 10 * k + rng.random((300, 400))).astype(np.float32) for k in (0, 1, 3, 5)]
    phases[0][100:120, 60:70] = np.nan
    whole = direct_depth(*(p.astype(float) for p in phases[:2]), *phases[2:], d_mm=180, delta_d_mm=40)
    parts = depth_map(
        [p[WINDOW].astype(float) for p in phases[:2]], phases[2:], d_mm=180, delta_d_mm=40, window=WINDOW, threads=2
    )
    np.testing.assert_array_equal(parts[WINDOW], whole[WINDOW].astype(np.float32))
    assert np.isnan(parts).sum() == parts.size - np.isfinite(whole[WINDOW]).sum()


def test_a_window_has_the_rays_of_the_whole_picture():
    np.testing.assert_allclose(rays(windowed(LENS, WINDOW)), rays(LENS)[WINDOW], atol=1e-14)


def test_a_window_is_found_and_counted_from_another():
    known = np.zeros((300, 400), bool)
    assert bounding_box(known) is None
    known[40, 60] = known[99, 200] = True
    box = bounding_box(known)
    assert box == (slice(40, 100), slice(60, 201))
    inner = np.arange(known.size).reshape(known.shape)
    np.testing.assert_array_equal(inner[WINDOW][within(box, WINDOW)], inner[box])
    assert inside(within(box, WINDOW), WINDOW) == box
    assert common([WINDOW, box]) == (slice(40, 100), slice(60, 201))
    with pytest.raises(ValueError, match="not seen at another"):
        common([WINDOW, (slice(0, 300), slice(301, 400))])


def test_what_is_lit_is_found_without_specks_and_can_be_grown_and_shrunk():
    black = np.full((200, 200), 9, np.uint8)
    white = black.copy()
    white[50:150, 60:140] = 190
    white[10, 10] = 255
    region = lit(white, black)
    assert bounding_box(region) == (slice(50, 150), slice(60, 140))
    assert bounding_box(grow(region)) == (slice(44, 156), slice(54, 146))
    assert bounding_box(shrink(region)) == (slice(56, 144), slice(66, 134))


@pytest.fixture
def geometry():
    plane = Plane(np.array([0.0, -0.0019, -0.0025]), np.eye(3) * 1e-16, 0.01, 1000)
    frame = reference_frame(plane)
    return RigGeometry(plane, plane, frame, 1.57, 1.57, 0.0, 180.0, 180.0, 0.006, {"planes": 6.0})


def evaluated(depth, geometry):
    phases = [np.full(depth.shape, 100.0 + k) for k in (0, 7, 1, 6)]
    directions = rays(windowed(LENS, (slice(0, depth.shape[0]), slice(0, depth.shape[1]))))
    return evaluate(depth.astype(np.float32), phases, geometry, directions, d_mm=180.0)


def test_two_flat_facets_have_a_step(geometry):
    rng = np.random.default_rng(2)
    depth = rng.normal(0, 0.01, (120, 160))
    depth[:, 80:] += 3.0
    found = evaluated(depth, geometry)
    assert [step.name for step in found.steps] == ["1-2"]
    assert found.steps[0].height_mm == pytest.approx(3.0, abs=0.02)
    assert found.without_steps == ""
    assert found.noise_mm == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    ("shape", "said", "facets"),
    [
        (lambda v, u: 0.0002 * ((u - 40) ** 2 + (v - 60) ** 2) + 5.0 * (u > 80), "facet 1, 2 is curved", 2),
        (lambda v, u: 0.0 * v * u, "one facet was found, a step needs two", 1),
        (lambda v, u: np.where(u < 5, 0.0, np.nan) * v, "no facet can be found|no smooth patch", 0),
    ],
)
def test_why_there_are_no_steps_is_said(geometry, shape, said, facets):
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:120, :160].astype(float)
    found = evaluated(shape(v, u) + rng.normal(0, 0.003, v.shape), geometry)
    assert found.steps == ()
    assert len(found.planes) == facets
    assert any(part in found.without_steps for part in said.split("|"))
