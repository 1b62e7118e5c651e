"""Pictures and maps side by side: frames, phases, heights, residuals, facets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from types import MappingProxyType
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from irpmd_rig.report.drawing import styled

Window = tuple[slice, slice]
Colours = Literal["grey", "phase", "height", "signed", "facets"]

_MAPS = MappingProxyType({"grey": "gray", "phase": "twilight", "height": "viridis", "signed": "RdBu_r"})
_ROW = 4  # panels side by side
_SHOWN_PX = 420  # a panel's longer side: as many as it shows
_PAGE_IN = 10.8  # a row is no wider: text keeps its size on a page
_PANEL_IN, _LEFT_IN, _BOTTOM_IN, _TOP_IN, _BAR_IN = 3.2, 0.7, 0.45, 0.3, 1.0
_FLATTEST, _TALLEST = 0.25, 2.0  # height of a panel over its width
_TICKS = 4
_UNKNOWN = "#d9d9d9"


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """One picture of a figure.

    Attributes
    ----------
    title
        Above it.
    values
        Numbers or truth values, (H, W); NaN where not known, which is shown in grey.
    """

    title: str
    values: NDArray[Any]


@styled
def maps(
    panels: Sequence[Panel],
    *,
    unit: str,
    colours: Colours,
    window: Window | None = None,
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Pictures of one size with one colour bar, four in a row.

    Parameters
    ----------
    panels
        One or more pictures of the same size.
    unit
        What the numbers are, beside the colour bar.
    colours
        grey for frames; phase for what repeats after 2 pi; height for maps from low to high; signed for what goes to
        either side of zero; facets for labels, 0 for none.
    window
        Rows and columns of the camera's picture that are shown, for the axes; the whole picture by default.
    limits
        Lowest and highest number shown. By default what is between the 0.5 and the 99.5 percentile of what is known;
        of signed maps as far to either side; -pi to pi for phase.
    """
    height, width = panels[0].values.shape
    columns, rows = min(len(panels), _ROW), ceil(len(panels) / _ROW)
    wide_in = min(_PANEL_IN, (_PAGE_IN - _BAR_IN) / columns - _LEFT_IN)
    tall_in = wide_in * float(np.clip(height / width, _FLATTEST, _TALLEST))
    cell_in = (wide_in + _LEFT_IN, tall_in + _BOTTOM_IN + _TOP_IN)
    size_in = (columns * cell_in[0] + _BAR_IN, rows * cell_in[1])
    figure = Figure(figsize=size_in)
    stride = max(1, max(height, width) // _SHOWN_PX)
    shown = [_numbers(panel.values[::stride, ::stride], colours) for panel in panels]
    colouring = _colouring(shown, colours, limits)
    extent = _extent(window or (slice(0, height), slice(0, width)))
    for index, (panel, values) in enumerate(zip(panels, shown, strict=True)):
        left_in = (index % columns) * cell_in[0] + _LEFT_IN
        bottom_in = (rows - 1 - index // columns) * cell_in[1] + _BOTTOM_IN
        axes = figure.add_axes(_place(left_in, bottom_in, wide_in, tall_in, size_in))
        axes.set_facecolor(_UNKNOWN)
        # Without resampling: an SVG holds the numbers' own pixels.
        picture = axes.imshow(values, interpolation="none", extent=extent, **colouring)
        axes.set_title(panel.title)
        # Numbers at the outer panels only: every tick takes a millisecond to draw.
        if index // columns == rows - 1:
            axes.set_xlabel("column (px)")
            axes.xaxis.set_major_locator(MaxNLocator(_TICKS))
        else:
            axes.set_xticks([])
        if index % columns == 0:
            axes.set_ylabel("row (px)")
            axes.yaxis.set_major_locator(MaxNLocator(_TICKS))
        else:
            axes.set_yticks([])
    place = _place(columns * cell_in[0] + 0.12, (rows - 1) * cell_in[1] + _BOTTOM_IN, 0.13, tall_in, size_in)
    _bar(figure, picture, place, unit, colours)
    return figure


def _numbers(values: NDArray[Any], colours: Colours) -> NDArray[np.float32]:
    numbers = values.astype(np.float32)
    if colours == "facets":
        numbers[numbers <= 0] = np.nan
    return np.ma.masked_invalid(numbers)


def _colouring(
    shown: Sequence[NDArray[np.float32]], colours: Colours, limits: tuple[float, float] | None
) -> dict[str, Any]:
    """Colour map and limits for `imshow`."""
    if colours == "facets":
        count = max(1, max(int(np.ma.max(np.ma.filled(values, 1.0))) for values in shown))
        base = mpl.colormaps["tab10" if count <= 10 else "tab20"]
        map_ = ListedColormap([base(k % base.N) for k in range(count)])
        return {"cmap": map_, "norm": BoundaryNorm(np.arange(count + 1) + 0.5, count)}
    low, high = limits or _limits(shown, colours)
    return {"cmap": _MAPS[colours], "vmin": low, "vmax": high}


def _limits(shown: Sequence[NDArray[np.float32]], colours: Colours) -> tuple[float, float]:
    if colours == "phase":
        return -np.pi, np.pi
    known = np.concatenate([values.compressed() for values in shown])  # type: ignore[attr-defined]
    if known.size == 0:
        return 0.0, 1.0
    if colours == "signed":
        reach = float(np.percentile(np.abs(known), 99.5)) or 1.0
        return -reach, reach
    low, high = np.percentile(known, [0.5, 99.5])
    return float(low), float(high) if high > low else float(low) + 1.0


def _bar(figure: Figure, picture: Any, place: tuple[float, float, float, float], unit: str, colours: Colours) -> None:
    if colours == "facets":
        count = picture.norm.Ncmap
        figure.colorbar(picture, cax=figure.add_axes(place), label=unit, ticks=range(1, count + 1))
        return
    bar = figure.colorbar(picture, cax=figure.add_axes(place), label=unit, extend="neither")
    if colours == "phase":
        bar.set_ticks([-np.pi, 0, np.pi], labels=["-π", "0", "π"])


def _extent(window: Window) -> tuple[float, float, float, float]:
    """Edges of the picture; the centre of its first pixel is at its row and column."""
    rows, columns = window
    return columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5


def _place(
    left_in: float, bottom_in: float, width_in: float, height_in: float, size_in: tuple[float, float]
) -> tuple[float, float, float, float]:
    wide, tall = size_in
    return left_in / wide, bottom_in / tall, width_in / wide, height_in / tall
