"""The pieces of a measurement that are cut up for speed and memory give what the whole would."""

from dataclasses import replace

import numpy as np
import pytest

from irpmd_rig.core import Facets, Intrinsics, Plane, rays, reference_frame
from irpmd_rig.core.reconstruction.depth_equation import equation_depth
from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.processing import FramesUnusable, optics
from irpmd_rig.processing.depth import depth_map, windowed
from irpmd_rig.processing.estimates import MethodResult
from irpmd_rig.processing.evaluate import Change, evaluate, facet_means, step_covariances_um2
from irpmd_rig.processing.frames import FringeStation, check_along_y
from irpmd_rig.processing.methods import _thinning
from irpmd_rig.processing.regions import bounding_box, common, grow, inside, lit, overlap, shrink, within
from irpmd_rig.processing.report import MethodFiles, _method_content

LENS = Intrinsics((400, 300), (460.0, 461.0), (198.0, 151.0), (-0.14, 0.15, -4e-5, -1.6e-4, 0.0))
WINDOW = slice(37, 213), slice(51, 301)


def views(phases):
    sigmas = tuple(np.full(phase.shape, 0.01, np.float32) for phase in phases)
    rows, columns = phases[0].shape
    return Views((0.0, 40.0), tuple(phases), sigmas, (slice(0, rows), slice(0, columns)))


def test_bands_on_two_threads_are_the_depth_equation():
    rng = np.random.default_rng(1)
    r1, r2, m1, m2 = ((100 + 10 * k + rng.random((300, 400))).astype(np.float32) for k in (0, 1, 3, 5))
    r1[100:120, 60:70] = np.nan
    whole = equation_depth(views((m1, m2)), views((r1, r2)), d_mm=180)
    parts = depth_map(views((m1, m2)), views((r1, r2)), d_mm=180, threads=2)
    np.testing.assert_array_equal(parts.depth_mm, whole.depth_mm)
    np.testing.assert_array_equal(parts.sigma_mm, whole.sigma_mm)
    assert np.isnan(parts.depth_mm[100:120, 60:70]).all()


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


def test_two_windows_share_what_both_have():
    assert overlap(WINDOW, (slice(0, 100), slice(200, 400))) == (slice(37, 100), slice(200, 301))
    rows, columns = overlap(WINDOW, (slice(250, 300), slice(0, 400)))
    assert (rows.stop - rows.start, columns.stop - columns.start) == (0, 250)


def evaluated(depth, changes=lambda _: ()):
    frame = reference_frame(Plane(np.array([0.0, -0.0019, -0.0025]), np.eye(3) * 1e-16, 0.01, 1000))
    directions = rays(windowed(LENS, (slice(0, depth.shape[0]), slice(0, depth.shape[1]))))
    return evaluate(depth.astype(np.float32), frame, directions, changes)


def test_two_flat_facets_have_a_step():
    rng = np.random.default_rng(2)
    depth = rng.normal(0, 0.01, (120, 160))
    depth[:, 80:] += 3.0
    found = evaluated(depth)
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
def test_why_there_are_no_steps_is_said(shape, said, facets):
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:120, :160].astype(float)
    found = evaluated(shape(v, u) + rng.normal(0, 0.003, v.shape))
    assert found.steps == ()
    assert len(found.planes) == facets
    assert any(part in found.without_steps for part in said.split("|"))


def test_steps_share_what_moves_their_facets():
    rng = np.random.default_rng(4)
    depth = rng.normal(0, 0.01, (120, 240))
    depth[:, 80:] += 3.0
    depth[:, 160:] += 2.0
    # The middle facet rises by 4 um with the calibration, the last by 3 um by chance, all by 9 um with the alignment.
    moved = (
        Change("calibration", np.array([0.0, 4e-3, 0.0])),
        Change("random", np.array([0.0, 0.0, 3e-3])),
        Change("alignment", np.full(3, 9e-3)),
    )
    found = evaluated(depth, lambda _: moved)
    alone = evaluated(depth)
    assert [step.calibration_um for step in found.steps] == pytest.approx([4, 4])
    assert [step.alignment_um for step in found.steps] == pytest.approx([0, 0])
    assert found.steps[1].random_um == pytest.approx(np.hypot(alone.steps[1].random_um, 3))
    assert found.covariance_um2[0, 1] == pytest.approx(alone.covariance_um2[0, 1] - 16)
    # The middle plane enters both at its opposite edges: what tilts it makes both larger, what lifts it but one.
    assert 0 < alone.covariance_um2[0, 1] < alone.covariance_um2[0, 0]
    parts = step_covariances_um2(found.planes, moved)
    np.testing.assert_allclose(sum(parts.values()), found.covariance_um2)


def test_the_mean_over_a_facet_leaves_unknown_pixels_out():
    labels = np.array([[0, 1, 1, 2], [3, 0, 1, 2]], np.int32)
    change = np.array([[9.0, 1.0, 2.0, np.nan], [5.0, 9.0, 3.0, np.nan]])
    np.testing.assert_array_equal(facet_means(change, labels, 3), [2.0, np.nan, 5.0])


@pytest.mark.parametrize(("width", "every"), [(100, 8), (40, 4), (8, 2), (1, 1)])
def test_small_facets_are_thinned_less(width, every):
    labels = np.zeros((120, 240), np.int32)
    labels[:, :100], labels[10:40, 120 : 120 + width] = 1, 2
    assert _thinning(Facets(labels, 2, 0.1)) == every


def test_fringes_along_y_are_as_those_along_x():
    along_x = tuple(FringeStation(number, "object", "x", (64.0, 63.0, 56.0), 4, ()) for number in range(2))
    along_y = tuple(replace(station, orientation="y") for station in along_x)
    check_along_y(along_x, along_y)
    for other in ({"counts": (48.0, 47.0, 42.0)}, {"steps": 5}):
        with pytest.raises(FramesUnusable, match=r"station 1 \(object\): fringes along y differ"):
            check_along_y(along_x, (along_y[0], replace(along_y[1], **other)))


def test_maps_of_the_glass_are_kept_all_or_none(monkeypatch):
    rig = optics.KnownRig(None, (1, 2), np.empty((0, 2)), True, None, 1.0, None)

    def tabulated(model, axis):
        if model == 2 and failing:
            raise MemoryError
        return model, axis

    monkeypatch.setattr(optics, "tabulate", tabulated)
    failing = True
    with pytest.raises(MemoryError):
        rig.varied_maps()
    failing = False
    assert rig.varied_maps() == [((1, 0), (1, 1)), ((2, 0), (2, 1))]


def test_an_unknown_covariance_is_none_in_json():
    nothing = np.full((3, 4), np.nan, np.float32)
    maps, window = DepthMap(nothing, nothing), (slice(0, 3), slice(0, 4))
    covariance = np.array([[4.0, np.nan], [np.nan, np.inf]])
    result = MethodResult(
        "facets", maps, window, np.zeros((3, 4), np.int32), (), (), covariance, "", "", np.nan, None, ()
    )
    content = _method_content(result, MethodFiles("depth.npy", "sigma.npy"), ())
    assert content["step_covariance_um2"] == [[4.0, None], [None, None]]
