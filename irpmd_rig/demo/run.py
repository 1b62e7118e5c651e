"""The demonstration from a world file to tables, pictures and files: everything over REST, as a lab script does it."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from plyfile import PlyData
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from irpmd_rig.client import Client, ClientError, Event, Run
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.demo.lab_script import CALIBRATIONS, MEASURE, calibrate, measure
from irpmd_rig.demo.private_daemon import PrivateDaemon, SimulatedRig
from irpmd_rig.demo.result import Measured, Result
from irpmd_rig.demo.truth import Found, TruthQuestion
from irpmd_rig.shipped import world_file

# Below, the sprayed strip has too few pixels for its plane.
SIZES_PX = (320, 4096)
# The world's clock: nobody wants to wait for the stages, and no frame is lost by being rendered late.
TIME_SCALE = 20.0

_COLUMNS = (
    TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} frames"),
    TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Request:
    """What the user asked for."""

    world: str
    subject: str
    out: Path
    seed: int | None
    size_px: int | None


def run(request: Request, console: Console) -> Result:
    """Calibrate, measure, compare with the truth, and leave everything in a folder.

    Raises
    ------
    MeasurementError
        For a world file that does not hold, an unknown object, or a measurement that cannot be made.
    """
    started = time.monotonic()
    rig = _rig(request)
    # Before the long part: a folder that cannot be written should be known now.
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeasurementError(f"--out must name a folder that can be made: {error}") from None
    # The frames lie there until the end, more than a gigabyte of them: on the disk that was chosen.
    with (
        tempfile.TemporaryDirectory(prefix=".rig-", dir=request.out) as private,
        TruthQuestion(rig, request.subject, Path(private)) as question,
    ):
        console.print("a simulated rig and its daemon start", highlight=False)
        daemon = PrivateDaemon(rig, Path(private))
        try:
            question.settle()
            with daemon as client:
                measured = _measured(client, request, console)
        except ClientError as error:
            raise MeasurementError(str(error)) from error
        finally:
            daemon.close()
        truth = question.answer(_found(request.out, measured))
    result = Result(
        world=request.world,
        subject=request.subject,
        out=request.out,
        seconds=time.monotonic() - started,
        measured=measured,
        truth=truth,
    )
    _write_json(result.as_json(), request.out / "result.json")
    return result


def _rig(request: Request) -> SimulatedRig:
    if request.size_px is not None and not SIZES_PX[0] <= request.size_px <= SIZES_PX[1]:
        raise MeasurementError(f"--size-px takes {SIZES_PX[0]} to {SIZES_PX[1]}, not {request.size_px}")
    if request.seed is not None and not 0 <= request.seed < 2**63:
        raise MeasurementError(f"--seed takes a whole number from 0 to 2^63 - 1, not {request.seed}")
    return SimulatedRig(world_file(request.world), request.seed, request.size_px, TIME_SCALE)


def _measured(client: Client, request: Request, console: Console) -> Measured:
    """Do what a lab script does, with its own functions, and show how far it is."""
    frames = _frames(client, request.subject)
    with Progress(*_COLUMNS, console=console) as progress:
        on_event = _shown(client, progress, frames)
        runs = calibrate(client, on_event)
        run = measure(client, request.subject, request.out, on_event)
    return _kept(client, runs, run, request.out)


def _frames(client: Client, subject: str) -> int:
    """Frames that will be taken; refuses what the rig cannot do before it begins."""
    total = 0
    for recipe in (*CALIBRATIONS, MEASURE.format(subject=subject)):
        checked = client.validate(recipe)
        if not checked.ok or checked.estimate is None:
            raise MeasurementError("\n".join(f"{p.file}:{p.line}: {p.what}; {p.remedy}" for p in checked.problems))
        total += checked.estimate.frames
    return total


def _shown(client: Client, progress: Progress, frames: int) -> Callable[[Event], None]:
    """Make what turns events into a progress bar."""
    task = progress.add_task("", total=frames)
    done: dict[str, int] = {}

    def show(event: Event) -> None:
        if event.run_id is None:
            return
        if event.run_id not in done:
            begun = client.run(event.run_id)
            progress.console.print(begun.name, highlight=False)
            progress.update(task, description=begun.kind)
        if event.kind == "progress":
            done[event.run_id] = event.data["frames_done"]
            progress.update(task, completed=sum(done.values()))
        else:
            done.setdefault(event.run_id, 0)

    return show


def _kept(client: Client, runs: dict[str, Run], run: Run, out: Path) -> Measured:
    """Put the calibrations' results beside the measurement's, which are there already."""
    (out / "result.json").replace(out / "measurement.json")
    parts = {recipe: client.result(done.id, "calibration.json") for recipe, done in runs.items()}
    camera, plate, geometry, _ = (parts[recipe] for recipe in CALIBRATIONS)
    _write_json(
        {"intrinsics": camera["intrinsics"], "plate_relation": plate, "geometry": geometry}, out / "calibration.json"
    )
    client.download(runs["reference"].id, "results/arrays.npz", out / "references.npz")
    return Measured(camera, plate, geometry, client.result(run.id))


def _found(out: Path, measured: Measured) -> Found:
    depth = np.load(out / "depth_mm.npy")
    # The points are the known pixels in their order.
    labels = np.zeros(depth.shape, np.int32)
    labels[np.isfinite(depth)] = PlyData.read(str(out / "points.ply"))["vertex"]["facet"]
    places = tuple((step["at_mm"][0], step["at_mm"][1]) for step in measured.steps)
    return Found(depth, labels, len(measured.measurement["facets"]), places)


def _write_json(content: object, path: Path) -> None:
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
