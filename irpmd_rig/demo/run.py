"""The demonstration from a world file to tables, pictures and files."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from irpmd_rig.core import Drawing
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.demo.capture import Photographer
from irpmd_rig.demo.evaluate import Evaluation, evaluate
from irpmd_rig.demo.files import write_calibration, write_json, write_measurement
from irpmd_rig.demo.pictures import write_pictures
from irpmd_rig.demo.procedure import (
    COUNTS,
    FRAMES,
    STAGE_POSITIONS_MM,
    STEPS,
    Measurement,
    calibrate,
    measure,
)
from irpmd_rig.demo.result import Result, Truth
from irpmd_rig.shipped import world_file
from sims.errors import SimulationError, WorldError
from sims.rig import SimulatedRig
from sims.truth import true_d_mm, true_steps_mm
from sims.world import World, load_world

THREADS = 2
# Below, the sprayed strip has too few pixels for its plane.
SIZES_PX = (320, 4096)


@dataclass(frozen=True, slots=True)
class Request:
    """What the user asked for."""

    world: str
    subject: str
    out: Path
    seed: int | None
    size_px: int | None


def run(request: Request, console: Console) -> Result:
    """Calibrate, measure, evaluate and write everything.

    Raises
    ------
    MeasurementError
        For a world file that does not hold, an unknown object, or a measurement that cannot be made.
    """
    try:
        world = _load(request)
        return _run(world, request, console)
    except (WorldError, SimulationError) as error:
        raise MeasurementError(str(error)) from None


def _load(request: Request) -> World:
    world = load_world(world_file(request.world))
    if request.subject not in world.objects:
        raise MeasurementError(
            f"the world has no object {request.subject!r}; it has {', '.join(sorted(world.objects))}"
        )
    if request.size_px is None:
        return world
    if not SIZES_PX[0] <= request.size_px <= SIZES_PX[1]:
        raise MeasurementError(f"--size-px takes {SIZES_PX[0]} to {SIZES_PX[1]}, not {request.size_px}")
    return world.with_camera_size(request.size_px)


def _run(world: World, request: Request, console: Console) -> Result:
    # Before the long part: a folder that cannot be written should be known now.
    try:
        request.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeasurementError(f"--out must name a folder that can be made: {error}") from None
    started = time.monotonic()
    columns = (
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total} frames"),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("starting", total=FRAMES)
        photographer = Photographer(
            SimulatedRig(world, seed=request.seed),
            COUNTS,
            STEPS,
            THREADS,
            lambda frames: progress.advance(task, frames),
        )

        def announce(text: str) -> None:
            progress.console.print(text, highlight=False)
            progress.update(task, description=text.split(":")[0])

        calibration = calibrate(photographer, drawing(world), announce)
        measurement = measure(photographer, calibration, request.subject, announce)
        progress.console.print("facets, steps, files and pictures", highlight=False)
    evaluation = evaluate(measurement, calibration)
    truth = _truth(photographer.rig, request.subject, measurement, evaluation)
    write_calibration(calibration, request.out)
    write_measurement(measurement, request.out)
    write_pictures(measurement, evaluation.labels, request.out)
    result = Result(
        world=request.world,
        subject=request.subject,
        seed=photographer.rig.world.seed,
        out=request.out,
        seconds=time.monotonic() - started,
        calibration=calibration,
        evaluation=evaluation,
        truth=truth,
    )
    write_json(result.as_json(), request.out / "result.json")
    return result


def _truth(rig: SimulatedRig, subject: str, measurement: Measurement, evaluation: Evaluation) -> Truth:
    """Ask the world, after the measurement, what it should have found."""
    rig.move_stage1(STAGE_POSITIONS_MM[0])
    points = rig.trace().point_mm
    world_steps = true_steps_mm(rig.world, subject)
    inside = evaluation.labels > 0
    error = (measurement.depth_mm - points[..., 2])[inside]
    planes = [_exact_plane(points[evaluation.labels == k + 1]) for k in range(evaluation.facet_count)]
    steps = [float((planes[k + 1] - planes[k]) @ (*step.at_mm, 1.0)) for k, step in enumerate(evaluation.steps)]
    return Truth(
        steps_mm=steps if len(steps) == len(world_steps) else world_steps,
        d_mm=true_d_mm(rig.world),
        focal_px=rig.world.camera.fc_px,
        depth_rms_um=1e3 * float(np.sqrt(np.nanmean(error**2))),
    )


def _exact_plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients (x, y, 1) of the plane through traced points, which have no noise."""
    known = points[np.isfinite(points).all(axis=1)]
    design = np.column_stack([known[:, :2], np.ones(len(known))])
    return np.asarray(np.linalg.lstsq(design, known[:, 2], rcond=None)[0])


def drawing(world: World) -> Drawing:
    """Nominal places of camera and glass: what a lab reads off the rig's drawing, misalignments excluded."""
    camera, glass = world.camera, world.glass
    return Drawing(
        camera_xy_mm=(camera.position_mm[0], camera.position_mm[1]),
        heading=(camera.axis[0], camera.axis[1]),
        d_point_mm=(glass.centre_mm[0], glass.centre_mm[1]),
    )
