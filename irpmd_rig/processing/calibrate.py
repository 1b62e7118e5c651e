"""Calibrations and references from a run's frames: the paper's procedure, one run a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import (
    calibrate_camera,
    fit_plate_relation,
    smooth_reference,
)
from irpmd_rig.processing.archive import (
    ARRAYS,
    CameraResult,
    relation_arrays,
    relation_content,
)
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.frames import FringeStation, read_frame
from irpmd_rig.processing.job import Job, known_number, size_of
from irpmd_rig.processing.optics import known_glass
from irpmd_rig.processing.phases import StationPhase, check_station
from irpmd_rig.processing.regions import Mask, grow
from irpmd_rig.processing.stage_position import stage_position
from irpmd_rig.processing.values import ProcessedRun
from irpmd_rig.store.record import Kind
from irpmd_rig.store.results import CALIBRATION


def calibrate_camera_run(job: Job) -> ProcessedRun:
    """Intrinsics from the plain frames labelled ``board``; the one of the highest view lies on the white plate.

    Raises
    ------
    ProcessingError
        If the checkerboard is not known, or too few boards are found.
    MeasurementError
        As `irpmd_rig.core.calibrate_camera`.
    """
    boards = [e for e in job.entries if e.label == "board" and e.role == "plain"]
    if not boards:
        raise FramesUnusable("there are no plain frames labelled 'board'", "measure again, or complete the folder")
    boards.sort(key=lambda entry: (-1 if entry.view is None else entry.view, entry.index or 0))
    on_plate = boards[-1].stage2_mm
    if on_plate is None:
        raise FramesUnusable(
            "stage2_mm of the last board, which lies on the white plate, is not known", "give it in the manifest"
        )
    job.plan(3)
    job.step(f"{len(boards)} pictures of the checkerboard are read")
    images = [read_frame(job.folder, entry) for entry in boards]
    job.step("corners and intrinsics")
    camera = calibrate_camera(images, job.facts.known_checkerboard(), threads=job.threads)
    plate_view = len(boards) - 1
    if plate_view in camera.missed_views:
        raise ProcessingError(
            "the checkerboard was not found in the last picture, where it lies on the white plate",
            "take the pictures again with all corners of it in view",
        )
    result = CameraResult(camera, plate_view, on_plate)
    content = {**job.header(camera.intrinsics.size_px), **result.content()}
    job.begin_results()
    job.folder.results.write_json(CALIBRATION, content)
    job.wrote(CALIBRATION)
    return job.finished(
        fx_px=camera.intrinsics.focal_px[0],
        sigma_fx_px=camera.sigma_focal_px[0],
        fy_px=camera.intrinsics.focal_px[1],
        boards=len(camera.boards),
        missed_boards=len(camera.missed_views),
    )


def calibrate_plate_run(job: Job) -> ProcessedRun:
    """Absolute phase to plate position, from the fringes labelled ``plate`` at each position of stage 2.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    MeasurementError
        As `irpmd_rig.core.fit_plate_relation`.
    """
    stations = job.stations("plate")
    counts = one_pattern(stations)
    job.plan(len(stations) + 2)
    stack: NDArray[np.float32] | None = None
    quality = []
    for place, station in enumerate(stations):
        job.step(f"plate at {station.stage2_mm:g} mm")
        phase = job.phase(station, take=True)
        quality.append(station_quality(job, station, phase))
        if stack is None:
            stack = np.empty((len(stations), *phase.phase_rad.shape), np.float32)
        same_size(phase.phase_rad, stack.shape[1:])
        stack[place] = phase.phase_rad
    job.step("a polynomial a pixel")
    assert stack is not None  # there is at least one station
    relation = fit_plate_relation(stack, [station.stage2_mm for station in stations], threads=job.threads)
    content = {
        **job.header(size_of(stack.shape[1:])),
        "counts": list(counts),
        **relation_content(relation),
        "stations": quality,
    }
    job.begin_results()
    job.folder.results.write_arrays(ARRAYS, relation_arrays(relation))
    job.wrote(ARRAYS)
    job.folder.results.write_json(CALIBRATION, content)
    job.wrote(CALIBRATION)
    return job.finished(order=relation.order, valid_fraction=float(relation.valid.mean()), positions=len(stations))


def reference_run(job: Job) -> ProcessedRun:
    """Phase of the reference mirror at each position: white and black frames ``glass``, fringes ``mirror``.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If the calibration of the geometry does not fit.
    MeasurementError
        As `irpmd_rig.core.smooth_reference`.
    """
    stations = job.stations("mirror")
    counts = one_pattern(stations)
    job.chain.check_fringes(counts)
    job.plan(len(stations) + 1)
    sprayed: Mask = job.chain.array("calibrate-geometry", "sprayed")
    rig = known_glass(job.chain)
    arrays: dict[str, NDArray[np.generic]] = {}
    quality, true_mm, noise_rad = [], [], 0.0
    for place, station in enumerate(stations):
        job.step(f"reference at {station.stage1_mm:g} mm")
        phase = job.phase(station, take=True)
        glass = job.region("glass", glass_station(job, station))
        same_size(glass, sprayed.shape)
        smooth = smooth_reference(phase.phase_rad, region=~grow(sprayed | glass))
        arrays[f"position_{place + 1}_rad"] = smooth.phase_rad
        noise_rad = max(noise_rad, smooth.noise_rad)
        true_mm.append(stage_position(station, phase, rig).used_mm)
        fit = {"noise_rad": known_number(smooth.noise_rad), "coherent_rad": known_number(smooth.coherent_rad)}
        quality.append({**station_quality(job, station, phase), **fit})
    content = {
        **job.header(size_of(sprayed.shape)),
        "counts": list(counts),
        "positions_mm": [station.stage1_mm for station in stations],
        "positions_measured": [station.measured for station in stations],
        "positions_true_mm": true_mm,
        "positions_true_is": "by the glass seen directly in the same frames, where the rig model and enough of it is",
        "phases": "position_k_rad of arrays.npz: smoothed absolute phase at positions_mm[k - 1]; NaN where not seen",
        "stations": quality,
    }
    job.begin_results()
    job.folder.results.write_arrays(ARRAYS, arrays)
    job.wrote(ARRAYS)
    job.folder.results.write_json(CALIBRATION, content)
    job.wrote(CALIBRATION)
    return job.finished(positions_mm=[station.stage1_mm for station in stations], noise_rad=noise_rad)


def damaged_calibration(job: Job, kind: Kind, error: Exception) -> Refused:
    """Say which calibration cannot be read."""
    return Refused(f"{kind} {job.chain.uses[kind]} is damaged: {error!r}", "make it again")


def one_pattern(stations: tuple[FringeStation, ...]) -> tuple[float, ...]:
    """Fringe counts of all stations; raises FramesUnusable if they differ in them or in phase steps."""
    patterns = {(station.counts, station.steps) for station in stations}
    if len(patterns) > 1:
        raise FramesUnusable("the stations differ in fringe counts or phase steps", "measure again")
    return stations[0].counts


def glass_station(job: Job, mirror: FringeStation) -> int:
    """Station of the white and black frames of the glass alone, at the mirror's position."""
    window = job.facts.stage1.in_position_mm
    there = {
        e.station for e in job.entries
        if e.label == "glass" and e.stage1_mm is not None and abs(e.stage1_mm - mirror.stage1_mm) <= window + 1e-9
    }  # fmt: skip
    if len(there) != 1:
        raise FramesUnusable(
            f"there are {len(there)} stations with white and black frames labelled 'glass' at {mirror.stage1_mm:g} mm; "
            "one is needed",
            "measure again, or complete the folder",
        )
    return there.pop()


def station_quality(job: Job, station: FringeStation, phase: StationPhase) -> dict[str, object]:
    """What is known of a station's frames and phase; raises FramesUnusable if they fail their checks."""
    checks = check_station(job.folder, station, job.step)
    return {"station": station.number, "label": station.label, **checks, **phase.quality()}


def same_size(array: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    """Refuse pictures of different sizes; raises FramesUnusable."""
    if array.shape != shape:
        raise FramesUnusable(f"pictures differ in size: {array.shape} and {shape}", "measure again")
