"""Pictures of a measurement, as the paper's Figures 6 to 8 show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irpmd_rig.core import wrapped_phases
from irpmd_rig.demo.procedure import COUNTS, Measurement

_SHOWN_PX = 1024  # a picture's longer side: no screen shows more


def write_pictures(measurement: Measurement, facets: NDArray[np.int32], folder: Path) -> None:
    """Write PNG pictures of frames, wrapped and absolute phase, depth and facets into ``folder``."""
    seen = _bounding_box(np.isfinite(measurement.depth_mm))
    frames = measurement.frames
    _panels(
        folder / "frames.png",
        [(f"{count:g} fringes, step 1", frames[k, 0]) for k, count in enumerate(COUNTS)],
        "frame (DN)",
        "gray",
    )
    wrapped = wrapped_phases(frames)
    lit = wrapped.modulation_dn > 0.1 * np.nanpercentile(wrapped.modulation_dn, 99)
    _panels(
        folder / "wrapped_phase.png",
        [
            (f"{count:g} fringes", np.where(lit[k], wrapped.phase_rad[k], np.nan)[seen])
            for k, count in enumerate(COUNTS)
        ],
        "wrapped phase (rad)",
        "gray",
    )
    _panels(
        folder / "absolute_phase.png",
        [(f"stage position {k + 1}", phase.phase_rad) for k, phase in enumerate(measurement.phases)],
        "absolute phase (rad)",
        "viridis",
    )
    depth = measurement.depth_mm[seen]
    limits = np.nanpercentile(depth, [0.5, 99.5])
    _panels(folder / "depth.png", [("height above the reference", depth)], "mm", "viridis", limits)
    found = np.where(facets > 0, facets, np.nan)[seen]
    _panels(folder / "facets.png", [("facets found", found)], "facet", "tab10")
    _surface(folder / "surface.png", measurement.points_mm[seen], limits)


def _bounding_box(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _panels(
    path: Path,
    panels: list[tuple[str, NDArray[np.generic]]],
    unit: str,
    colours: str,
    limits: NDArray[np.float64] | None = None,
) -> None:
    figure = Figure(figsize=(5.2 * len(panels), 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    low, high = limits if limits is not None else (None, None)
    for index, (title, picture) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), index + 1)
        stride = max(1, max(picture.shape) // _SHOWN_PX)
        shown = axes.imshow(
            picture[::stride, ::stride],
            cmap=colours,
            vmin=low,
            vmax=high,
            interpolation="nearest",
            extent=(0, picture.shape[1], picture.shape[0], 0),
        )
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    figure.colorbar(shown, ax=figure.axes, label=unit, shrink=0.8)
    figure.savefig(path, dpi=110, bbox_inches="tight")


def _surface(path: Path, points: NDArray[np.float64], limits: NDArray[np.float64]) -> None:
    """Draw the shape in perspective, as the paper's Figure 8 does."""
    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    stride = max(1, max(points.shape[:2]) // 160)
    x, y, z = (points[::stride, ::stride, k] for k in range(3))
    known = np.isfinite(z) & (z >= limits[0] - 1) & (z <= limits[1] + 1)
    cloud = axes.scatter(x[known], y[known], z[known], c=z[known], s=2, cmap="viridis")
    axes.set(xlabel="X (mm)", ylabel="Y (mm)", zlabel="Z (mm)")
    axes.set_box_aspect((1, 1, 0.5))
    axes.view_init(elev=32, azim=-60)
    figure.colorbar(cloud, ax=axes, label="height (mm)", shrink=0.7)
    figure.savefig(path, dpi=110)
