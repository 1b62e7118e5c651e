"""Figures from arrays: what is drawn is what was given."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from irpmd_rig.report.drawing import png, svg
from irpmd_rig.report.figures_graphs import Series, bars, curves, histogram, step_deviations, step_parts
from irpmd_rig.report.figures_maps import Panel, maps
from irpmd_rig.report.figures_surface import surface

RAMP = np.linspace(0, 1, 60 * 40).reshape(60, 40)


def shown(figure: Figure) -> np.ma.MaskedArray:
    return figure.axes[0].images[0].get_array()


def every_figure() -> dict[str, Figure]:
    holed = np.where(RAMP > 0.2, RAMP, np.nan)
    series = [Series("one", [1.0, 2.0], [0.1, 0.2]), Series("other", [1.5, np.nan])]
    y, x = np.mgrid[:30, :40].astype(float)
    return {
        "frames": maps([Panel("a", (255 * RAMP).astype(np.uint8))] * 5, unit="DN", colours="grey"),
        "phase": maps([Panel("a", holed)], unit="rad", colours="phase"),
        "signed": maps([Panel("a", holed - 0.5)], unit="um", colours="signed"),
        "facets": maps([Panel("a", (4 * RAMP).astype(int))], unit="facet", colours="facets"),
        "nothing known": maps([Panel("a", np.full((9, 9), np.nan))], unit="mm", colours="height"),
        "no facet": maps([Panel("a", np.zeros((9, 9), int))], unit="facet", colours="facets"),
        "steps": step_deviations(["1-2", "2-3"], series, beside="truth"),
        "parts": step_parts(["1-2", "2-3"], series),
        "curves": curves([0.0, 1.0], series, x_label="x", y_label="y", limit=(1.2, "goal")),
        "bars": bars([str(k) for k in range(40)], range(40), y_label="y"),
        "histogram": histogram(RAMP, x_label="x", normal=(0.5, 0.3)),
        "empty histogram": histogram([np.nan], x_label="x"),
        "surface": surface(np.dstack([x, y, x * y])),
        "empty surface": surface(np.full((5, 5, 3), np.nan)),
    }


@pytest.fixture(scope="module")
def figures() -> dict[str, Figure]:
    return every_figure()


def test_every_figure_is_an_svg_that_needs_nothing_else(figures: dict[str, Figure]):
    for name, figure in figures.items():
        document = svg(figure)
        root = ElementTree.fromstring(document)
        assert root.tag.endswith("svg"), name
        for reference in re.findall(r'href="([^"]*)"', document):
            assert reference.startswith(("#", "data:")), name
        assert "<script" not in document


def test_the_same_figure_gives_the_same_file(figures: dict[str, Figure]):
    assert svg(figures["steps"]) == svg(every_figure()["steps"])
    assert png(figures["steps"])[:4] == b"\x89PNG"


def test_what_is_not_known_is_not_drawn():
    values = np.array([[1.0, np.nan], [3.0, 4.0]])
    picture = shown(maps([Panel("a", values)], unit="mm", colours="height"))
    np.testing.assert_array_equal(picture.mask, np.isnan(values))
    np.testing.assert_array_equal(picture.compressed(), [1, 3, 4])
    labels = shown(maps([Panel("a", np.array([[0, 1], [2, 0]]))], unit="facet", colours="facets"))
    np.testing.assert_array_equal(labels.mask, [[True, False], [False, True]])


def test_limits_are_those_that_colours_mean():
    values = RAMP - 0.3
    values[0, 0] = 1e6
    assert maps([Panel("a", values)], unit="", colours="signed").axes[0].images[0].get_clim() == pytest.approx(
        (-0.7, 0.7), abs=0.02
    )
    assert maps([Panel("a", values)], unit="", colours="phase").axes[0].images[0].get_clim() == (-np.pi, np.pi)
    low, high = maps([Panel("a", values)], unit="", colours="height").axes[0].images[0].get_clim()
    assert (low, high) == pytest.approx((-0.3, 0.7), abs=0.02)
    limited = maps([Panel("a", values)], unit="", colours="height", limits=(0.0, 2.0))
    assert limited.axes[0].images[0].get_clim() == (0.0, 2.0)


def test_a_large_picture_is_made_smaller_and_keeps_its_axes():
    figure = maps(
        [Panel("a", np.zeros((2048, 1024)))], unit="DN", colours="grey", window=(slice(100, 2148), slice(0, 1024))
    )
    assert max(shown(figure).shape) < 600
    assert figure.axes[0].images[0].get_extent() == [-0.5, 1023.5, 2147.5, 99.5]


def test_steps_stand_at_what_was_measured_with_their_uncertainty():
    figure = step_deviations(["1-2", "2-3"], [Series("ours", [1.0, -2.0], [0.5, 0.25])], beside="truth")
    axes = figure.axes[0]
    marks = next(line for line in axes.lines if line.get_label() == "ours")
    np.testing.assert_array_equal(marks.get_ydata(), [1.0, -2.0])
    reaches = sorted({round(float(np.ptp(path[:, 1])), 6) for bar in axes.collections for path in bar.get_segments()})
    assert reaches == [0.5, 1.0, 2.0]  # one and two sigma to either side: 2 x 0.25, 2 x 0.5 = 4 x 0.25, 4 x 0.5
    assert axes.get_ylabel() == "measured minus truth (µm)"


def test_methods_stand_beside_each_other():
    series = [Series("a", [1.0]), Series("b", [1.0]), Series("c", [1.0])]
    axes = step_deviations(["1-2"], series, beside="nominal").axes[0]
    places = [float(line.get_xdata()[0]) for line in axes.lines if not line.get_label().startswith("_")]
    assert len(set(places)) == 3
    assert np.mean(places) == pytest.approx(0, abs=1e-12)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b", "c"]
