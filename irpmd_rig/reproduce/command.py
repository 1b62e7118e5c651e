"""The paper, reproduced by one command: runs taken, page, figures, numbers and recipes written."""

from __future__ import annotations

import csv
import json
import logging
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from irpmd_rig.bench.accuracy_lab import Done, Lab
from irpmd_rig.bench.accuracy_truth import Truth, ask_truth
from irpmd_rig.bench.accuracy_worlds import Change, write_world
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.recipes.plan import plan
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.report.content import Table
from irpmd_rig.report.html import drawings, render
from irpmd_rig.report.run import REPORT, write_report
from irpmd_rig.reproduce.page import numbers, page
from irpmd_rig.reproduce.results import Entry, Results
from irpmd_rig.reproduce.scheme import PARTS, STEP, Scheme, Task
from irpmd_rig.reproduce.taken import Taken, measured

NUMBERS = "numbers.json"
SIZES_PX = (384, 4096)
"""Below, the sprayed strip has too few pixels for its plane."""

_THREADS = 2
_FRAME_S, _RUN_S = 0.3, 4.0  # on two cores: a frame of 2048 x 2048 with all that is computed of it, and a run
_MAPS = (".npy", ".npz", ".tif", ".ply")
_COLUMNS = (
    TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} frames"),
    TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
)  # fmt: skip

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Request:
    """What the user asked for.

    Attributes
    ----------
    out
        Folder for everything.
    size_px
        Columns of the camera.
    seed
        Of the world's misalignment and of all noise.
    parts
        Of `irpmd_rig.reproduce.scheme.PARTS`.
    """

    out: Path
    size_px: int = 2048
    seed: int = 1
    parts: tuple[str, ...] = PARTS


def reproduce(request: Request, console: Console) -> dict[str, Any]:
    """Take all runs and write report, figures, numbers, tables and recipes.

    Returns
    -------
    dict
        What `numbers.json` holds.

    Raises
    ------
    MeasurementError
        For options that cannot be, or a folder that cannot be written.
    ProcessingError
        For a calibration or reference that cannot be computed.
    """
    _check(request)
    request = replace(request, out=request.out.resolve())
    started = time.monotonic()
    worlds, runs = request.out / "worlds", request.out / "runs"
    try:
        for folder in (worlds, runs, request.out / "recipes", request.out / "figures", request.out / "tables"):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeasurementError(f"--out must name a folder that can be made: {error}") from None
    desk = _Desk(request, _Truths(runs, request.size_px))
    tasks = list(Scheme(request.seed, worlds, request.parts).tasks())
    with _progress(console, tasks, request.size_px) as advance, _tidied(runs):
        for task, done in Lab(runs, request.size_px, _THREADS).carry_out(tasks):
            desk.keep(task, done)
            advance(task)
    content = write_world(worlds / "world.yaml", request.seed, Change())
    results = desk.results(content, time.monotonic() - started)
    return _write(request, results, desk.reports)


def _check(request: Request) -> None:
    if strange := [part for part in request.parts if part not in PARTS]:
        raise MeasurementError(f"--only takes {', '.join(PARTS)} with commas between them, not {', '.join(strange)}")
    if not SIZES_PX[0] <= request.size_px <= SIZES_PX[1]:
        raise MeasurementError(f"--size-px takes {SIZES_PX[0]} to {SIZES_PX[1]}, not {request.size_px}")
    if not 0 <= request.seed < 2**53:
        raise MeasurementError(f"--seed takes a whole number from 0 to 2^53 - 1, not {request.seed}")


@dataclass(slots=True)
class _Truths:
    """What worlds tell of their objects, asked once."""

    folder: Path
    size_px: int
    known: dict[tuple[Path, str], Truth] = field(default_factory=dict)

    def of(self, world: Path, subject: str) -> Truth:
        if (world, subject) not in self.known:
            # One world's at a time: each holds a map of the whole picture.
            self.known = {key: truth for key, truth in self.known.items() if key[0] == world}
            self.known[world, subject] = ask_truth(world, subject, self.size_px, self.folder)
        return self.known[world, subject]


class _Desk:
    """Keeps of every run what page and numbers need; large arrays go."""

    def __init__(self, request: Request, truths: _Truths) -> None:
        self._request = request
        self._truths = truths
        self._recipes: dict[str, str] = {}
        self._calibrations: dict[str, tuple[str, dict[str, Any]]] = {}
        self._measurements: list[Taken] = []
        self._runs: list[Entry] = []
        self.reports: list[str] = []

    def keep(self, task: Task, done: Done) -> None:
        """Keep what a run found, while its frames are there."""
        self._runs.append(Entry(task, done.folder.id, self._recipe_file(task)))
        if not task.subject:
            self._calibrations.setdefault(task.key, (done.folder.id, dict(done.content)))
        else:
            with_views = "figures" in self._request.parts and task.use in ("paper", "precise")
            truth = self._truths.of(task.world, task.subject)
            self._measurements.append(measured(task, done, truth, with_views=with_views))
        if task.use in ("calibration", "paper", "visible", "precise", "precise-visible"):
            self._report(done)
        if task.subject:
            _drop_maps(done.folder.results.folder)

    def _report(self, done: Done) -> None:
        """Report of a run of its own: not of repetitions, which are all alike."""
        write_report(done.folder)
        report = done.folder.results.path(REPORT)
        self.reports.append(str(report.relative_to(self._request.out)))

    def _recipe_file(self, task: Task) -> str:
        """Write a recipe where it is the first of its text."""
        if task.recipe not in self._recipes:
            name = f"recipes/{len(self._recipes) + 1:02d}-{task.key}.yaml"
            (self._request.out / name).write_text(task.recipe, encoding="utf-8")
            self._recipes[task.recipe] = name
        return self._recipes[task.recipe]

    def results(self, world: dict[str, Any], seconds: float) -> Results:
        """Everything that was kept."""
        truth = self._truths.of(self._request.out / "worlds" / "world.yaml", STEP)
        return Results(
            self._request.seed,
            self._request.size_px,
            world,
            truth,
            self._calibrations,
            self._measurements,
            self._runs,
            seconds,
        )


def _drop_maps(folder: Path) -> None:
    """Delete arrays of a run: 150 MB of each at full size; what they told is kept."""
    for file in folder.iterdir():
        if file.suffix in _MAPS:
            file.unlink()


@contextmanager
def _tidied(runs: Path) -> Iterator[None]:
    """Leave neither frames nor the arrays of calibrations, however it ends."""
    try:
        yield
    finally:
        for folder in runs.glob("rendered-*"):
            shutil.rmtree(folder)
        for folder in (runs / "data").glob("*/results"):
            _drop_maps(folder)


@contextmanager
def _progress(console: Console, tasks: Sequence[Task], size_px: int) -> Iterator[Any]:
    frames = {task.recipe: plan(read_recipe(task.recipe)[0]).frames for task in tasks}
    total = sum(frames[task.recipe] for task in tasks)
    minutes = (len(tasks) * _RUN_S + total * _FRAME_S * (size_px / 2048) ** 2) / 60
    told = f"{len(tasks)} runs, {total} frames of {size_px} columns: about {minutes:.0f} minutes on two free cores"
    console.print(told, highlight=False)
    with Progress(*_COLUMNS, console=console) as progress:
        shown = progress.add_task(tasks[0].key, total=total)

        def advance(task: Task) -> None:
            progress.update(shown, description=task.key, advance=frames[task.recipe])

        yield advance


def _write(request: Request, results: Results, reports: Sequence[str]) -> dict[str, Any]:
    content = numbers(results, request.parts)
    (request.out / NUMBERS).write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    whole, tables = page(results, request.parts, reports)
    drawn = drawings(whole)
    for name, document in drawn.items():
        (request.out / "figures" / f"{name}.svg").write_text(document, encoding="utf-8")
    for name, table in tables.items():
        _write_table(request.out / "tables" / f"{name}.csv", table)
    (request.out / REPORT).write_text(render(whole, drawn), encoding="utf-8")
    return content


def _write_table(path: Path, table: Table) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table.columns)
        writer.writerows(table.rows)
