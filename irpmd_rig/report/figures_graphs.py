"""Graphs: steps with their error bars, parts of an uncertainty, curves, histograms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from irpmd_rig.report.drawing import COLOURS, styled

_WIDTH_IN, _HEIGHT_IN = 5.1, 3.1
_PLACE = (0.13, 0.15, 0.84, 0.73)
_SPREAD = 0.6  # of the distance between two steps: what the methods' marks take
_BINS = 80

Numbers = NDArray[np.floating] | Sequence[float]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Numbers that belong together in a graph.

    Attributes
    ----------
    name
        In the legend.
    values
        (n,); NaN where not known.
    sigma
        One sigma of each; None if it is not known of any.
    """

    name: str
    values: Numbers
    sigma: Numbers | None = None


@styled
def step_deviations(steps: Sequence[str], series: Sequence[Series], *, beside: str) -> Figure:
    """Measured minus true steps of one or more methods, um, with error bars of one sigma and (thin) of two.

    Parameters
    ----------
    steps
        Their names, n.
    series
        One a method, in um.
    beside
        What is subtracted: ``"truth"``, ``"nominal"``.
    """
    figure, axes = _graph(max(_WIDTH_IN, 1.0 + 0.28 * len(steps) * (len(series) + 1)))
    places = np.arange(len(steps), dtype=np.float64)
    axes.axhline(0, color="#444444", linewidth=1)
    for index, one in enumerate(series):
        shift = _SPREAD * ((index + 0.5) / len(series) - 0.5)
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": "none"}
        values = np.asarray(one.values, dtype=np.float64)
        if one.sigma is not None:
            sigma = np.asarray(one.sigma, dtype=np.float64)
            axes.errorbar(places + shift, values, 2 * sigma, elinewidth=0.8, capsize=2, **style)
            axes.errorbar(places + shift, values, sigma, elinewidth=2.4, **style)
        axes.plot(places + shift, values, marker="o", markersize=5, label=one.name, **style)
    axes.set_xticks(places, labels=steps)
    axes.set_xlim(-0.6, len(steps) - 0.4)
    axes.set(xlabel="step", ylabel=f"measured minus {beside} (µm)")
    axes.grid(axis="y")
    _legend(axes, len(series))
    return figure


@styled
def step_parts(steps: Sequence[str], parts: Sequence[Series]) -> Figure:
    """Parts of the uncertainty of each step, um: bars beside each other, for their squares add up, not they.

    Parameters
    ----------
    steps
        Their names, n.
    parts
        One sigma each, um: random, calibration, and whatever else there is.
    """
    figure, axes = _graph(_WIDTH_IN)
    places = np.arange(len(steps), dtype=np.float64)
    width = 0.8 / len(parts)
    for index, part in enumerate(parts):
        shift = width * (index + 0.5) - 0.4
        axes.bar(places + shift, part.values, 0.92 * width, label=part.name, color=COLOURS[index % len(COLOURS)])
    axes.set_xticks(places, labels=steps)
    axes.set(xlabel="step", ylabel="one sigma (µm)")
    axes.grid(axis="y")
    _legend(axes, len(parts))
    return figure


@styled
def curves(
    x: Numbers,
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    log_y: bool = False,
    limit: tuple[float, str] | None = None,
) -> Figure:
    """Curves over one quantity, each with a band of one sigma where it is known.

    Parameters
    ----------
    x
        (n,)
    series
        One a curve.
    x_label, y_label
        Quantities with their units.
    log_y
        Whether the ordinate is logarithmic.
    limit
        A value of the ordinate that is drawn as a dashed line, and its name.
    """
    figure, axes = _graph(_WIDTH_IN)
    at = np.asarray(x, dtype=np.float64)
    marker = "o" if at.size <= 40 else ""
    for index, one in enumerate(series):
        colour = COLOURS[index % len(COLOURS)]
        values = np.asarray(one.values, dtype=np.float64)
        axes.plot(at, values, marker=marker, markersize=3.5, linewidth=1.5, color=colour, label=one.name)
        if one.sigma is not None:
            sigma = np.asarray(one.sigma, dtype=np.float64)
            axes.fill_between(at, values - sigma, values + sigma, color=colour, alpha=0.2, linewidth=0)
    if limit is not None:
        axes.axhline(limit[0], color="#444444", linewidth=1, linestyle="--", label=limit[1])
    if log_y:
        axes.set_yscale("log")
    if np.all(at == np.round(at)):
        # Counts have no halves.
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.grid()
    _legend(axes, len(series) + (limit is not None))
    return figure


@styled
def bars(names: Sequence[str], values: Numbers, *, y_label: str, x_label: str = "") -> Figure:
    """One bar a name."""
    figure, axes = _graph(_WIDTH_IN)
    axes.bar(np.arange(len(names)), np.asarray(values, dtype=np.float64), 0.7, color=COLOURS[0])
    every = max(1, len(names) // 15)
    axes.set_xticks(range(0, len(names), every), labels=list(names)[::every])
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.grid(axis="y")
    return figure


@styled
def histogram(values: Numbers, *, x_label: str, normal: tuple[float, float] | None = None) -> Figure:
    """How often values occur, beside a normal distribution of the same number.

    Parameters
    ----------
    values
        NaN is left out.
    x_label
        Quantity with its unit.
    normal
        Mean and one sigma of the distribution that is expected.
    """
    figure, axes = _graph(_WIDTH_IN)
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[np.isfinite(known)]
    if known.size:
        low, high = np.percentile(known, [0.1, 99.9])
        margin = 0.05 * (high - low) or 1.0
        edges = np.linspace(low - margin, high + margin, _BINS + 1)
        axes.hist(known, edges, color=COLOURS[0], label="found")
        if normal is not None:
            middle = (edges[1:] + edges[:-1]) / 2
            mean, sigma = normal
            density = np.exp(-0.5 * ((middle - mean) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
            axes.plot(middle, known.size * np.diff(edges) * density, color=COLOURS[1], label="expected")
            _legend(axes, 2)
    axes.set(xlabel=x_label, ylabel="number")
    return figure


def _graph(width_in: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width_in, _HEIGHT_IN))
    left, bottom, width, height = _PLACE
    return figure, figure.add_axes(
        (left * _WIDTH_IN / width_in, bottom, 1 - (1 - width) * _WIDTH_IN / width_in, height)
    )


def _legend(axes: Any, entries: int) -> None:
    """Above the graph, where it covers nothing."""
    if entries > 1:
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(entries, 4), borderaxespad=0.2)
