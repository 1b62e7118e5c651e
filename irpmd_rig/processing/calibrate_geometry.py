"""Calibration of the geometry from a run's frames: the paper's planes and d, and the whole rig from its own fringes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import PlateRelation, RigGeometry, calibrate_geometry, place_plate, rays
from irpmd_rig.core.calibration.rig_calibrate import calibrate_rig
from irpmd_rig.core.calibration.rig_calibration import NominalProjector, RigCalibration, RigView
from irpmd_rig.processing.archive import (
    ARRAYS,
    CameraResult,
    Content,
    geometry_content,
    read_relation,
)
from irpmd_rig.processing.archive_rig import VARIATIONS, rig_content, variations_content
from irpmd_rig.processing.calibrate import damaged_calibration, glass_station, one_pattern, same_size, station_quality
from irpmd_rig.processing.frames import FringeStation, at_same_positions, check_along_y
from irpmd_rig.processing.glass import glass_outline
from irpmd_rig.processing.job import Job
from irpmd_rig.processing.phases import StationPhase
from irpmd_rig.processing.regions import Mask, grow, shrink, solid
from irpmd_rig.processing.values import ProcessedRun
from irpmd_rig.store.results import CALIBRATION


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What the frames show, position by position; the first is the paper's."""

    stations: tuple[FringeStation, ...]
    phases: tuple[StationPhase, ...]
    phases_y: tuple[StationPhase, ...] | None
    sprayed: Mask
    glass: tuple[Mask, ...]
    quality: tuple[dict[str, object], ...]


def calibrate_geometry_run(job: Job) -> ProcessedRun:
    """Planes, angles, d, frame M, rig model: white and black frames ``sprayed`` and ``glass``, fringes ``mirror``.

    The rig model is made where the mirror was taken at two or more stage positions.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If the calibrations of camera and plate do not fit.
    MeasurementError
        As `irpmd_rig.core.calibrate_geometry` and `irpmd_rig.core.calibration.rig_calibrate.calibrate_rig`.
    """
    stations = job.stations("mirror")
    counts = one_pattern(stations)
    job.chain.check_fringes(counts)
    drawing = job.drawing
    job.plan(len(stations) + 3)
    camera, relation = _camera(job), _relation(job)
    seen = _seen(job, stations)
    job.step("planes, angles, distance")
    geometry = _geometry(job, camera, relation, seen)
    content = {
        **job.header(camera.camera.intrinsics.size_px),
        "counts": list(counts),
        "positions_mm": [station.stage1_mm for station in stations],
        **geometry_content(geometry, stations[0].stage1_mm),
        "stage1_measured": stations[0].measured,
        "stations": list(seen.quality),
        "rig_model": None,
    }
    job.step("camera, glass, stage axis and projector together")
    rig = _rig(job, camera, geometry, seen) if len(stations) > 1 else None
    if rig is not None:
        content["rig_model"] = _rig_content(rig, seen, drawing.d_point_mm)
    _write(job, content, seen, rig)
    return job.finished(
        d_mm=geometry.d_mm,
        sigma_d_mm=geometry.sigma_d_mm,
        gamma_deg=float(np.rad2deg(geometry.gamma_rad)),
        rig_model_chi2=None if rig is None else rig.chi2_per_dof,
    )


def _seen(job: Job, stations: tuple[FringeStation, ...]) -> _Seen:
    sprayed = job.region("sprayed")
    glass, phases, quality = [], [], []
    for station in stations:
        job.step(f"mirror at {station.stage1_mm:g} mm")
        phase = job.phase(station, take=True)
        where = job.region("glass", glass_station(job, station))
        for region in (sprayed, where):
            same_size(region, phase.phase_rad.shape)
        phases.append(phase)
        glass.append(where)
        quality.append(station_quality(job, station, phase))
    across = None
    if job.has("mirror", "y"):
        along_y = at_same_positions(stations, job.stations("mirror", "y"), job.facts.stage1.in_position_mm)
        check_along_y(stations, along_y)
        across = tuple(job.phase(station, take=True) for station in along_y)
    job.release()
    return _Seen(stations, tuple(phases), across, sprayed, tuple(glass), tuple(quality))


def _geometry(job: Job, camera: CameraResult, relation: PlateRelation, seen: _Seen) -> RigGeometry:
    on_plate = next(board for board in camera.camera.boards if board.view == camera.plate_view)
    return calibrate_geometry(
        camera.camera,
        relation,
        place_plate(on_plate, camera.plate_position_mm),
        seen.phases[0].phase_rad,
        shrink(seen.sprayed),
        shrink(seen.glass[0]),
        rays=rays(camera.camera.intrinsics),
        drawing=job.drawing,
        board_view=on_plate.view,
    )


def _rig(job: Job, camera: CameraResult, geometry: RigGeometry, seen: _Seen) -> RigCalibration:
    nominal = NominalProjector(job.facts.projector.size_px, max(seen.stations[0].counts))
    views = [_view(seen, place) for place in range(len(seen.stations))]
    return calibrate_rig(views, camera.camera, geometry, nominal, board=job.facts.known_checkerboard())


def _view(seen: _Seen, place: int) -> RigView:
    """One position, what is seen of mirror, sprayed mirror and glass apart, without their rims."""
    phase, glass = seen.phases[place], seen.glass[place]
    whole = slice(0, glass.shape[0]), slice(0, glass.shape[1])
    other = grow(seen.sprayed | glass)
    return RigView(
        stage1_mm=seen.stations[place].stage1_mm,
        phase_rad=phase.phase_rad,
        sigma_rad=phase.sigma_in(whole),
        mirror=shrink(solid(np.isfinite(phase.phase_rad) & ~other)),
        sprayed=shrink(seen.sprayed) & ~grow(glass),
        glass=shrink(glass),
        phase_y_rad=None if seen.phases_y is None else seen.phases_y[place].phase_rad,
    )


def _rig_content(rig: RigCalibration, seen: _Seen, d_point_mm: tuple[float, float]) -> Content:
    positions = [station.stage1_mm for station in seen.stations]
    x, y = np.array(d_point_mm)
    d_mm = float(rig.model.glass_z_mm(x, y))
    spread = [float(model.glass_z_mm(x, y)) - d_mm for model in rig.variations]
    outline = glass_outline(rig.model, positions, [shrink(mask) for mask in seen.glass])
    return {
        **rig_content(rig, positions),
        "d_mm": d_mm,
        "sigma_d_mm": float(np.sqrt(np.square(spread).sum())),
        "d_is": "along the reference's normal, from the drawing's d_point to the glass at stage1 = 0",
        "glass_outline_mm": outline.tolist(),
        "glass_outline_is": "x and y of frame M at stage1 = 0 around what is seen of the glass directly",
    }


def _write(job: Job, content: Content, seen: _Seen, rig: RigCalibration | None) -> None:
    results = job.folder.results
    job.begin_results()
    residuals = {} if rig is None else {f"residual_at_{m.stage1_mm:g}_mm": m.sigmas for m in rig.residuals}
    results.write_arrays(ARRAYS, {"sprayed": seen.sprayed, "glass": seen.glass[0], **residuals})
    job.wrote(ARRAYS)
    if rig is not None:
        results.write_json(VARIATIONS, variations_content(rig))
        job.wrote(VARIATIONS)
    results.write_json(CALIBRATION, content)
    job.wrote(CALIBRATION)


def _camera(job: Job) -> CameraResult:
    try:
        return CameraResult.read(job.chain.content("calibrate-camera"))
    except (KeyError, TypeError, ValueError) as error:
        raise damaged_calibration(job, "calibrate-camera", error) from None


def _relation(job: Job) -> PlateRelation:
    array: partial[NDArray[np.generic]] = partial(job.chain.array, "calibrate-plate")
    try:
        return read_relation(job.chain.content("calibrate-plate"), array)
    except (KeyError, TypeError, ValueError) as error:
        raise damaged_calibration(job, "calibrate-plate", error) from None
