"""A measurement from a run's frames: depth map, points, facets and steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Intrinsics, RigGeometry, rays
from irpmd_rig.processing.archive import CameraResult, Content, read_geometry
from irpmd_rig.processing.chain import Chain
from irpmd_rig.processing.depth import depth_map, windowed
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.evaluate import SIGMA_TRAVEL_MM, Evaluation, evaluate
from irpmd_rig.processing.frames import FringeStation
from irpmd_rig.processing.job import Job, known_number
from irpmd_rig.processing.phases import StationPhase, check_station
from irpmd_rig.processing.pictures import write_pictures
from irpmd_rig.processing.regions import Window, bounding_box, common, inside, within
from irpmd_rig.processing.report import facet_content, steps_content, steps_table
from irpmd_rig.processing.values import ProcessedRun

DEPTH = "depth_mm.npy"
RESULT = "result.json"
_ANOTHER = "choose another calibration or reference, or make it again"


@dataclass(frozen=True, slots=True, eq=False)
class Optics:
    """What a measurement needs of its calibrations and its reference.

    Attributes
    ----------
    intrinsics
        The camera.
    geometry
        Planes, d and frame M.
    geometry_at_mm
        Stage 1 at which d holds.
    window
        Rows and columns in which the reference mirror is seen at every position.
    references_rad
        Phase of the reference mirror in this window, in the order of the reference's positions.
    """

    intrinsics: Intrinsics
    geometry: RigGeometry
    geometry_at_mm: float
    window: Window
    references_rad: tuple[NDArray[np.float64], ...]


def load_optics(chain: Chain) -> Optics:
    """Read the calibrations and the reference of a measurement; raises Refused if one is damaged."""
    try:
        geometry = chain.content("calibrate-geometry")
        window, references = _references(chain)
        return Optics(
            intrinsics=CameraResult.read(chain.content("calibrate-camera")).camera.intrinsics,
            geometry=read_geometry(geometry),
            geometry_at_mm=float(geometry["stage1_mm"]),
            window=window,
            references_rad=references,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise Refused(f"a calibration or the reference is damaged: {error!r}", _ANOTHER) from None


def _references(chain: Chain) -> tuple[Window, tuple[NDArray[np.float64], ...]]:
    """Phases of the reference mirror, cut to what is seen of it: the picture holds much else."""
    cut = []
    for place in range(len(chain.content("reference")["positions_mm"])):
        whole = chain.array("reference", f"position_{place + 1}_rad")
        box = bounding_box(np.isfinite(whole))
        if box is None:
            raise ValueError(f"the reference mirror is not seen at position {place + 1}")
        # A copy, so that the whole is let go.
        cut.append((box, whole[box].astype(np.float64)))
    window = common([box for box, _ in cut])
    return window, tuple(np.ascontiguousarray(phase[within(window, box)]) for box, phase in cut)


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Everything between the phases and the results."""

    stations: tuple[FringeStation, ...]
    phases: tuple[StationPhase, ...]
    references_rad: tuple[NDArray[np.float64], ...]
    places: tuple[int, ...]
    d_mm: float
    delta_d_mm: float
    depth_mm: NDArray[np.float32]
    window: Window


def measure_run(job: Job, optics: Optics) -> ProcessedRun:
    """Measure an object by the depth equation, from the fringes labelled ``object`` at two positions of stage 1.

    The depth map is written first; everything else follows.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If calibrations or reference do not fit.
    ProcessingError
        If no pixel has a depth.
    MeasurementError
        As `irpmd_rig.core.direct_depth`.
    """
    job.plan(6)
    measured = _depth(job, optics)
    job.begin_results()
    job.folder.results.write_array(DEPTH, measured.depth_mm)
    job.wrote(DEPTH)
    quality = [_quality(job, *pair) for pair in zip(measured.stations, measured.phases, strict=True)]
    job.step("facets and steps")
    window = measured.window
    directions = rays(windowed(optics.intrinsics, window))
    depth = measured.depth_mm[window]
    evaluation = evaluate(
        depth,
        [
            *measured.references_rad,
            *(phase.phase_rad[window] for phase in measured.phases),
        ],
        optics.geometry,
        directions,
        d_mm=measured.d_mm,
    )
    job.step("points and maps")
    points = optics.geometry.frame.points_mm(depth.astype(np.float64), directions)
    results = job.folder.results
    results.write_map("depth_mm.tif", measured.depth_mm, "mm")
    job.wrote("depth_mm.tif")
    results.write_points("points.ply", points, {"facet": evaluation.labels})
    job.wrote("points.ply")
    results.write_table("steps.csv", steps_table(evaluation, job.record.nominal_steps_mm))
    job.wrote("steps.csv")
    job.step("pictures")
    for name in write_pictures(
        job.folder, measured.stations, measured.phases, window, depth, points, evaluation.labels
    ):
        job.wrote(name)
    results.write_json(RESULT, _content(job, optics, measured, evaluation, quality))
    job.wrote(RESULT)
    return job.finished(
        depth_pixels=int(np.count_nonzero(np.isfinite(depth))),
        depth_noise_um=1e3 * evaluation.noise_mm,
        facets=len(evaluation.planes),
        steps_mm=[step.height_mm for step in evaluation.steps],
        sigma_steps_um=[step.combined_um for step in evaluation.steps],
        without_steps=evaluation.without_steps or None,
    )


def _depth(job: Job, optics: Optics) -> _Measured:
    stations = job.stations("object")
    if len(stations) != 2:
        raise FramesUnusable(
            f"the object was taken at {len(stations)} stage positions; the depth equation takes two",
            "measure at two positions",
        )
    if len({(s.counts, s.steps) for s in stations}) > 1:
        raise FramesUnusable("the two positions differ in fringe counts or phase steps", "measure again")
    first, second = stations
    places = job.chain.reference_positions([first.stage1_mm, second.stage1_mm])
    job.chain.check_fringes(first.counts)
    phases = []
    for number, station in enumerate(stations, 1):
        job.step(f"phase at position {number}, {station.stage1_mm:g} mm")
        phases.append(job.phase(station, take=True))
    job.step("depth")
    job.release()
    seen = bounding_box(
        np.logical_and.reduce(
            [np.isfinite(optics.references_rad[place]) for place in places]
            + [np.isfinite(phase.phase_rad[optics.window]) for phase in phases]
        )
    )
    if seen is None:
        raise _nothing_seen()
    window = inside(seen, optics.window)
    references = tuple(optics.references_rad[place][seen] for place in places)
    # d holds where the geometry was calibrated; from there the stage takes mirror and camera away from the glass.
    d_mm = optics.geometry.d_mm + first.stage1_mm - optics.geometry_at_mm
    delta_d_mm = second.stage1_mm - first.stage1_mm
    depth = depth_map(
        references,
        [phase.phase_rad for phase in phases],
        d_mm=d_mm,
        delta_d_mm=delta_d_mm,
        window=window,
        threads=job.threads,
    )
    known = bounding_box(np.isfinite(depth[window]))
    if known is None:
        raise _nothing_seen()
    references = tuple(reference[known] for reference in references)
    return _Measured(stations, tuple(phases), references, places, d_mm, delta_d_mm, depth, inside(known, window))


def _nothing_seen() -> ProcessingError:
    return ProcessingError(
        "no pixel has a depth", "check that the object reflects the glass into the camera at both positions"
    )


def _quality(job: Job, station: FringeStation, phase: StationPhase) -> Content:
    return {
        "station": station.number,
        "stage1_mm": station.stage1_mm,
        "stage1_measured": station.measured,
        "exposure_us": station.entries[0].exposure_us,
        "led": station.entries[0].led,
        "intensity": station.entries[0].intensity,
        "bits": station.entries[0].bits,
        **check_station(job.folder, station, job.step),
        **phase.quality(),
    }


def _content(job: Job, optics: Optics, measured: _Measured, evaluation: Evaluation, quality: list[Content]) -> Content:
    record, geometry = job.record, optics.geometry
    known = np.isfinite(measured.depth_mm)
    reference_mm = job.chain.content("reference")["positions_mm"]
    return {
        **job.header(optics.intrinsics.size_px),
        "name": record.name,
        "operator": record.operator,
        "sample": record.sample,
        "notes": record.notes,
        "method": "depth equation",
        "counts": list(measured.stations[0].counts),
        "steps_a_set": measured.stations[0].steps,
        "positions": quality,
        "reference_positions_mm": [reference_mm[place] for place in measured.places],
        "d_mm": measured.d_mm,
        "sigma_d_mm": geometry.sigma_d_mm,
        "sigma_d_parts_um": geometry.sigma_parts_um,
        "delta_d_mm": measured.delta_d_mm,
        "sigma_delta_d_mm": SIGMA_TRAVEL_MM,
        "sigma_delta_d_is": "assumed: 1 um at either position",
        "depth": {
            "file": DEPTH,
            "unit": "mm",
            "is": "height above the reference plane, positive toward the glass; NaN where it cannot be known",
            "pixels": int(np.count_nonzero(known)),
            "fraction_of_picture": float(known.mean()),
            "rows": [measured.window[0].start, measured.window[0].stop],
            "columns": [measured.window[1].start, measured.window[1].stop],
            "noise_of_a_pixel_um": known_number(1e3 * evaluation.noise_mm),
        },
        "facets": [facet_content(plane) for plane in evaluation.planes],
        "step_definition": evaluation.definition,
        "steps": steps_content(evaluation, record.nominal_steps_mm),
        "without_steps": evaluation.without_steps or None,
        "measured_steps_mm": [step.height_mm for step in evaluation.steps],
        "nominal_steps_mm": list(record.nominal_steps_mm),
    }
