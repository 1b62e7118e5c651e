"""What is kept of a run: figures beside the truth, and pictures that are small enough to be kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.bench.accuracy_lab import Done
from irpmd_rig.bench.accuracy_truth import Compared, Truth, compare
from irpmd_rig.core import decode, wrapped_phases
from irpmd_rig.report.reading import fringe_sets, read_run, thin_frames
from irpmd_rig.report.shape import Shape, read_shape
from irpmd_rig.reproduce.scheme import Task
from irpmd_rig.store.errors import FileNotInRun

PLAIN = "depth-equation, plain planes"
"""The paper's evaluation: its depth equation, and a least-squares plane of z over x and y through each step."""

_LIT = 0.1  # of the brightest parts: where a phase says something
_MARGIN = 0.06  # of the object's size, shown around it

Content = Mapping[str, Any]
Map = NDArray[np.floating]
Window = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps by one method beside the truth.

    Attributes
    ----------
    measured_mm, errors_um
        Each step; measured minus true.
    sigmas_um, random_um
        Stated: all parts together, and what differs at every repetition; NaN where the method states none.
    passed
        Whether the method's own checks passed.
    """

    measured_mm: tuple[float, ...]
    errors_um: tuple[float, ...]
    sigmas_um: tuple[float, ...]
    random_um: tuple[float, ...]
    passed: bool = True

    @property
    def largest_um(self) -> float:
        """Largest error without its sign; NaN where not every step was found."""
        return max(map(abs, self.errors_um), default=np.nan)

    @property
    def rms_um(self) -> float:
        """Root of the mean square error; NaN where not every step was found."""
        return float(np.sqrt(np.mean(np.square(self.errors_um)))) if self.errors_um else np.nan


NO_STEPS = Steps((), (), (), ())


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Pictures of a measurement, made thin, and its shape.

    Attributes
    ----------
    window
        Rows and columns of the frame that are shown.
    frames
        (sets, steps, h, w), at the first position.
    wrapped_rad
        (sets, h, w); NaN where too little light comes back.
    absolute_rad
        (h, w)
    shape
        None where nothing was reconstructed.
    error_um
        Depth of each pixel of the shape's window minus the true one; None as `shape`.
    """

    window: Window
    frames: NDArray[Any]
    wrapped_rad: Map
    absolute_rad: Map
    shape: Shape | None
    error_um: Map | None


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """A run that is over.

    Attributes
    ----------
    task
        What it was for.
    run_id
        Its folder's name.
    content
        Its `result.json` or `calibration.json`; empty for a measurement that could not be computed.
    steps
        By method; nothing of those that did not find every step.
    compared
        Figures of pixels beside the truth, by method.
    views
        None where no pictures were wanted.
    """

    task: Task
    run_id: str
    content: Content
    steps: Mapping[str, Steps]
    compared: Mapping[str, Compared]
    views: Views | None = None

    @property
    def phase_noise_mrad(self) -> float:
        """Of a pixel, as stated by the phase at the first position; NaN where nothing was computed."""
        positions = self.content.get("positions") or [{}]
        sigma = positions[0].get("sigma_rad")
        return np.nan if sigma is None else 1e3 * float(sigma)


def measured(task: Task, done: Done, truth: Truth, *, with_views: bool) -> Taken:
    """Set a measurement beside the truth while its maps and frames are there."""
    compared = compare(done, truth)
    steps = {
        name: _steps(done.content["methods"][name], found) for name, found in compared.items() if found.step_errors_um
    }
    views = None
    if done.content:
        shape = read_shape(read_run(done.folder, None))
        if shape is not None and done.content["method"] == "depth-equation":
            plain = plain_steps(shape, truth)
            steps |= {PLAIN: plain} if plain.errors_um else {}
        views = _views(done, shape, truth) if with_views else None
    return Taken(task, done.folder.id, done.content, steps, compared, views)


def _steps(method: Content, found: Compared) -> Steps:
    steps = method["steps"]
    passed = all(check["passed"] is not False for check in method["checks"])
    measured_mm = tuple(float(step["measured_mm"]) for step in steps)
    random_um = tuple(np.nan if step["random_um"] is None else float(step["random_um"]) for step in steps)
    return Steps(measured_mm, found.step_errors_um, found.step_sigmas_um, random_um, passed)


def plain_steps(shape: Shape, truth: Truth) -> Steps:
    """Steps between least-squares planes z = a x + b y + c through the points of each facet (the paper, section 3.3).

    Notes
    -----
    x and y are computed from the same noisy z, which biases such planes (physics notes, section 4): it is the paper's
    evaluation, not ours.
    """
    planes = []
    for facet in range(1, int(shape.labels.max(initial=0)) + 1):
        points = shape.points_mm[shape.labels == facet].astype(np.float64)
        centre = points[:, :2].mean(axis=0)
        design = np.column_stack([points[:, :2] - centre, np.ones(len(points))])
        planes.append((centre, np.linalg.lstsq(design, points[:, 2], rcond=None)[0]))
    if len(planes) != len(truth.steps_mm) + 1:
        return NO_STEPS
    measured_mm = []
    for (low, below), (high, above) in pairwise(planes):
        half = (high - low) / 2
        measured_mm.append(float(above[2] - above[:2] @ half - below[2] - below[:2] @ half))
    errors = tuple(1e3 * (value - true) for value, true in zip(measured_mm, truth.steps_mm, strict=True))
    unknown = (np.nan,) * len(errors)
    return Steps(tuple(measured_mm), errors, unknown, unknown)


def _views(done: Done, shape: Shape | None, truth: Truth) -> Views | None:
    run = read_run(done.folder, None)
    sets = fringe_sets(run.entries, "object")[0]
    window = _window(shape, truth.z_mm.shape)
    frames = thin_frames(run.folder, sets.entries, window)
    if frames is None:
        return None
    stack = frames.reshape(len(sets.counts), sets.steps, *frames.shape[1:])
    wrapped = wrapped_phases(stack)
    lit = wrapped.modulation_dn > _LIT * np.nanpercentile(wrapped.modulation_dn, 99)
    error_um = None
    if shape is not None:
        error_um = (1e3 * (_best_depth(done, shape) - truth.z_mm[shape.window])).astype(np.float32)
        error_um[shape.labels == 0] = np.nan
    return Views(
        window=window,
        frames=stack,
        wrapped_rad=np.where(lit, wrapped.phase_rad, np.float32(np.nan)),
        absolute_rad=decode(stack, sets.counts).phase_rad,
        shape=shape,
        error_um=error_um,
    )


def _best_depth(done: Done, shape: Shape) -> Map:
    """Heights by the chosen method itself: of facets, of their surfaces."""
    name = done.content["methods"][done.content["method"]]["depth_file"]
    try:
        whole: Map = done.folder.results.read_array(name)
    except FileNotInRun:
        return shape.depth_mm
    return whole[shape.window]


def _window(shape: Shape | None, size: tuple[int, ...]) -> Window:
    """Object with a margin; the whole picture where no object was found."""
    if shape is None:
        return slice(0, size[0]), slice(0, size[1])
    found = []
    for part, full in zip(shape.window, size, strict=True):
        margin = round(_MARGIN * (part.stop - part.start))
        found.append(slice(max(0, part.start - margin), min(full, part.stop + margin)))
    return found[0], found[1]
