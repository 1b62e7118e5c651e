"""How every figure looks, and how it becomes a file."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

_DPI = 110
COLOURS = ("#1b6ca8", "#d1495b", "#3a7d44", "#8e5ea2", "#c98a00", "#4d4d4d", "#00868b", "#a0522d")
"""Of series in graphs: told apart without seeing red and green, in this order."""

_STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "axes.grid": False,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dddddd",
    "legend.frameon": False,
    "figure.dpi": _DPI,
    "figure.facecolor": "white",
    # Text is drawn as paths: it looks the same wherever the file is opened.
    "svg.fonttype": "path",
    # The same figure gives the same file.
    "svg.hashsalt": "irpmd-rig",
}

P = ParamSpec("P")


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Let a function draw in the style that all figures share."""

    @wraps(draw)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return in_style


def svg(figure: Figure) -> str:
    """Figure as an SVG document, pictures inside it embedded."""
    with mpl.rc_context(_STYLE):
        stream = io.StringIO()
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
    return stream.getvalue()


def png(figure: Figure) -> bytes:
    """Figure as a PNG file."""
    with mpl.rc_context(_STYLE):
        stream = io.BytesIO()
        FigureCanvasAgg(figure).print_png(stream)
    return stream.getvalue()
