"""Pictures of a measurement, as the paper's Figures 6 to 8 show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from irpmd_rig.core import wrapped_phases
from irpmd_rig.core.calibration.rig_calibration import ResidualMap
from irpmd_rig.processing.frames import FringeStation, read_frame
from irpmd_rig.processing.phases import StationPhase
from irpmd_rig.processing.regions import Window
from irpmd_rig.store.results import Results
from irpmd_rig.store.run_folder import RunFolder

_DPI = 110
_PANEL_IN, _BAR_IN = 4.8, 1.1
_SHOWN_PX = 512  # a picture's longer side: as many as a panel shows
_SURFACE_PX = 100  # the same, of points in perspective


def write_pictures(
    folder: RunFolder,
    stations: Sequence[FringeStation],
    phases: Sequence[StationPhase],
    window: Window,
    depth_mm: NDArray[np.float32],
    points_mm: NDArray[np.float64],
    facets: NDArray[np.int32],
) -> tuple[str, ...]:
    """Write PNG pictures of frames, wrapped and absolute phase, depth and facets.

    Parameters
    ----------
    folder
        The run.
    stations, phases
        Its positions, and their phases of the whole picture.
    window
        Rows and columns of the picture in which a depth is known.
    depth_mm, points_mm, facets
        Of this window.

    Returns
    -------
    tuple of str
        Names of the pictures.
    """
    results = folder.results
    first = stations[0]
    step_1 = [read_frame(folder, first.entries[k * first.steps]) for k in range(len(first.counts))]
    titles = [f"{count:g} fringes" for count in first.counts]
    panels = [(f"{title}, step 1", frame) for title, frame in zip(titles, step_1, strict=True)]
    _panels(results, "frames.png", panels, "frame (DN)", "gray")
    panels = list(zip(titles, _wrapped(folder, first, window), strict=True))
    _panels(results, "wrapped_phase.png", panels, "wrapped phase (rad)", "gray", window)
    panels = [(f"stage position {k + 1}", phase.phase_rad) for k, phase in enumerate(phases)]
    _panels(results, "absolute_phase.png", panels, "absolute phase (rad)", "viridis")
    limits = np.nanpercentile(depth_mm, [0.5, 99.5])
    _panels(results, "depth.png", [("height above the reference", depth_mm)], "mm", "viridis", window, limits)
    found = np.where(facets > 0, facets, np.nan)
    _panels(results, "facets.png", [("facets found", found)], "facet", "tab10", window)
    _surface(results, "surface.png", points_mm, limits)
    return "frames.png", "wrapped_phase.png", "absolute_phase.png", "depth.png", "facets.png", "surface.png"


def write_residuals(results: Results, name: str, maps: Sequence[ResidualMap]) -> None:
    """Draw what a rig model leaves of the phases of each view, in sigmas of a cell."""
    panels = [(f"residual at {residual.stage1_mm:g} mm", residual.sigmas) for residual in maps]
    height, width = (size * maps[0].block_px for size in maps[0].sigmas.shape)
    window = slice(0, height), slice(0, width)
    _panels(results, name, panels, "phase residual (sigmas of a cell)", "coolwarm", window, np.array([-5.0, 5.0]))


def _wrapped(folder: RunFolder, station: FringeStation, window: Window) -> NDArray[np.float32]:
    """Wrapped phase of every set in a window, as coarse as it is shown; NaN where nothing is lit."""
    rows, columns = window
    stride = max(1, max(rows.stop - rows.start, columns.stop - columns.start) // _SHOWN_PX)
    thin = slice(rows.start, rows.stop, stride), slice(columns.start, columns.stop, stride)
    frames = np.stack([read_frame(folder, entry)[thin] for entry in station.entries])
    wrapped = wrapped_phases(frames.reshape(len(station.counts), station.steps, *frames.shape[1:]))
    lit = wrapped.modulation_dn > 0.1 * np.nanpercentile(wrapped.modulation_dn, 99)
    return np.where(lit, wrapped.phase_rad, np.float32(np.nan))


def _panels(
    results: Results,
    name: str,
    panels: Sequence[tuple[str, NDArray[np.generic]]],
    unit: str,
    colours: str,
    window: Window | None = None,
    limits: NDArray[np.floating] | None = None,
) -> None:
    """Draw pictures side by side with one colour bar, in fixed places: finding good ones takes longer than drawing."""
    figure, canvas = _figure(_PANEL_IN * len(panels) + _BAR_IN, _PANEL_IN)
    width = 1 / (len(panels) + _BAR_IN / _PANEL_IN)
    low, high = limits if limits is not None else (None, None)
    for index, (title, picture) in enumerate(panels):
        axes = figure.add_axes((width * (index + 0.16), 0.12, width * 0.8, 0.78))
        stride = max(1, max(picture.shape) // _SHOWN_PX)
        rows, columns = window or (slice(0, picture.shape[0]), slice(0, picture.shape[1]))
        shown = axes.imshow(
            picture[::stride, ::stride],
            cmap=colours,
            vmin=low,
            vmax=high,
            interpolation="nearest",
            extent=(columns.start, columns.stop, rows.stop, rows.start),
        )
        axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    bar = figure.add_axes((width * (len(panels) + 0.02), 0.12, width * 0.04, 0.78))
    figure.colorbar(shown, cax=bar, label=unit)
    _write(results, name, canvas)


def _surface(results: Results, name: str, points: NDArray[np.float64], limits: NDArray[np.floating]) -> None:
    """Draw the shape in perspective, as the paper's Figure 8 does."""
    figure, canvas = _figure(7.0, 5.6)
    axes: Any = figure.add_axes((0.0, 0.02, 0.8, 0.96), projection="3d")
    stride = max(1, max(points.shape[:2]) // _SURFACE_PX)
    x, y, z = (points[::stride, ::stride, k] for k in range(3))
    known = np.isfinite(z) & (z >= limits[0] - 1) & (z <= limits[1] + 1)
    cloud = axes.scatter(x[known], y[known], z[known], c=z[known], s=2, cmap="viridis")
    axes.set(xlabel="X (mm)", ylabel="Y (mm)", zlabel="Z (mm)")
    axes.set_box_aspect((1, 1, 0.5))
    axes.view_init(elev=32, azim=-60)
    figure.colorbar(cloud, cax=figure.add_axes((0.86, 0.15, 0.03, 0.7)), label="height (mm)")
    _write(results, name, canvas)


def _figure(width_in: float, height_in: float) -> tuple[Figure, FigureCanvasAgg]:
    figure = Figure(figsize=(width_in, height_in), dpi=_DPI)
    return figure, FigureCanvasAgg(figure)


def _write(results: Results, name: str, canvas: FigureCanvasAgg) -> None:
    canvas.draw()
    results.write_picture(name, np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3]))
