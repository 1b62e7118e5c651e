"""What takes time and what moves, from a run's frames: display delay, settle time, and the axis of stage1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import Intrinsics, RigGeometry, rays, wrapped_phases
from irpmd_rig.core.preparation.stage_axis import StageAxis, StageView, fit_stage_axis
from irpmd_rig.core.preparation.timing import display_delay, light_share, settling, stage_offset_mm
from irpmd_rig.processing.archive import CameraResult, Content, read_geometry
from irpmd_rig.processing.calibrate import glass_station
from irpmd_rig.processing.errors import FramesUnusable, Refused
from irpmd_rig.processing.frames import FringeStation, picture, read_frame, read_fringes
from irpmd_rig.processing.job import Job, known_number, size_of
from irpmd_rig.processing.preparing import write_findings
from irpmd_rig.processing.regions import Mask, grow, shrink
from irpmd_rig.processing.values import ProcessedRun
from irpmd_rig.processing.wishes import settle_wishes
from irpmd_rig.store.entries import ManifestEntry

_SAMPLED_PX = 1500  # of each region and position: the phases' noise is then far below what the geometry leaves


def delay_run(job: Job) -> ProcessedRun:
    """Time from the order to show a picture until its light is there, from frames labelled ``delay``.

    Raises
    ------
    FramesUnusable
        If frames or their times are missing.
    MeasurementError
        As `irpmd_rig.core.preparation.timing.display_delay`.
    """
    job.plan(2)
    job.step("light after the order")
    white, black = (picture(job.folder, job.entries, "delay", role) for role in ("white", "black"))
    entries = _timed(job, "delay", "switched")
    light = [light_share(read_frame(job.folder, entry), black, white) for entry in entries]
    found = display_delay(np.array([_after_s(entry) for entry in entries]), np.array(light))
    until_ms, before_ms = 1e3 * found.until_s, 1e3 * found.before_s
    words = (
        f"All light of a picture is there {until_ms:.0f} ms after the order to show it"
        + (f", and not yet after {before_ms:.0f} ms." if before_ms else ", at the first frame already.")
        + " Of a projector that is driven by its video input this is what display_delay_s has to be in the rig file, "
        "the order's own duration included; add a frame of the display to be safe."
    )
    content: Content = {
        "after_ms": (1e3 * found.after_s).tolist(),
        "light": found.light.tolist(),
        "light_is": "share of a white picture's light, over the lit pixels",
        "not_before_ms": before_ms,
        "delay_ms": until_ms,
    }
    write_findings(job, size_of(white.shape), words, content)
    return job.finished(words=words, delay_ms=until_ms)


def settle_run(job: Job) -> ProcessedRun:
    """Movement of stage1 after its motion has ended: fringes ``begin`` and ``end``, frames ``settle``.

    Raises
    ------
    FramesUnusable
        If frames or their times are missing.
    ProcessingError
        If the recipe part of the record is wrong.
    MeasurementError
        As `irpmd_rig.core.preparation.timing.stage_offset_mm`.
    """
    still_um = settle_wishes(job.record).still_um
    begin, end = job.stations("begin")[0], job.stations("end")[0]
    entries = _timed(job, "settle", "series")
    job.plan(4)
    job.step("phase at both places")
    phases = [job.phase(station, take=True) for station in (begin, end)]
    way_mm = end.stage1_mm - begin.stage1_mm
    # The picture of the series is the first step of the first set.
    finest = end.counts[0] / max(end.counts)
    growth = (phases[1].phase_rad - phases[0].phase_rad) * (finest / way_mm)
    job.release()
    job.step("fringes at rest")
    at_rest = wrapped_phases(read_fringes(job.folder, end)[:1])
    maps = at_rest.phase_rad[0], at_rest.modulation_dn[0], at_rest.mean_dn[0]
    job.step(f"{len(entries)} frames after the motion")
    off = [stage_offset_mm(read_frame(job.folder, entry), *maps, growth) for entry in entries]
    found = settling(np.array([_after_s(entry) for entry in entries]), np.array(off), 1e-3 * still_um)
    last_s = float(found.after_s[-1])
    words = (
        f"The stage stays within {still_um:g} um from {found.settle_s:.3f} s on after its controller says that "
        f"a motion has ended: settle_s of the rig file should be no less."
        if np.isfinite(found.settle_s)
        else f"The stage did not come to rest within {still_um:g} um in {last_s:.2f} s: look for vibration, take more "
        "frames, or allow more movement."
    ) + f" Movement is seen to {1e3 * found.sigma_mm:.2f} um (one sigma)."
    content: Content = {
        "after_s": found.after_s.tolist(),
        "off_um": (1e3 * found.off_mm).tolist(),
        "sigma_um": 1e3 * found.sigma_mm,
        "still_um": still_um,
        "settle_s": known_number(found.settle_s),
        "largest_um": float(1e3 * np.abs(found.off_mm).max()),
        "way_mm": way_mm,
    }
    write_findings(job, phases[0].size_px, words, content)
    return job.finished(words=words, settle_s=found.settle_s, largest_um=float(1e3 * np.abs(found.off_mm).max()))


def stage_axis_run(job: Job) -> ProcessedRun:
    """Direction and scale of stage1: white and black frames ``glass``, fringes ``mirror``, at each position.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If the calibration of the geometry does not fit.
    MeasurementError
        As `irpmd_rig.core.preparation.stage_axis.fit_stage_axis`.
    """
    stations = job.stations("mirror")
    job.chain.check_fringes(stations[0].counts)
    job.plan(len(stations) + 2)
    intrinsics, geometry, glass_at_mm, plate_sigma_rad = _optics(job)
    directions = geometry.frame.directions(rays(intrinsics)).reshape(-1, 3)
    along_y = job.stations("mirror", "y") if job.has("mirror", "y") else ()
    by_number = {station.number: station for station in along_y}
    # Phases along y tell where all stations have them.
    with_y = all(station.number in by_number for station in stations)
    views = []
    for station in stations:
        job.step(f"phase at {station.stage1_mm:g} mm")
        views.append(_view(job, station, by_number.get(station.number), directions))
    job.step("direction of the stage")
    normal, offset = geometry.frame.plane(geometry.glass)
    plane = float(-normal[0] / normal[2]), float(-normal[1] / normal[2]), float(offset / normal[2])
    found = fit_stage_axis(views, geometry.frame.camera_mm, plane, glass_at_mm)
    drift = found.axis[:2] / -found.axis[2]
    # The mirror's normal is no better known than the tilt of the plate by which it was measured.
    sigma = np.sqrt(np.square(found.sigma_rad) + _frame_sigma(geometry) ** 2 + plate_sigma_rad**2)
    words = _axis_words(drift, sigma, found, with_y=with_y)
    write_findings(job, intrinsics.size_px, words, _axis_content(found, drift, sigma))
    return job.finished(
        words=words,
        drift_x_deg=float(np.rad2deg(drift[0])),
        drift_y_deg=float(np.rad2deg(drift[1])),
        scale=found.scale,
        sigma_scale=found.sigma_scale,
    )


def _view(
    job: Job, station: FringeStation, along_y: FringeStation | None, directions: NDArray[np.float64]
) -> StageView:
    """Pixels spread over what is seen of the glass, directly and in the mirror."""
    phase = job.phase(station, take=True).phase_rad
    phase_y = None if along_y is None else job.phase(along_y, take=True).phase_rad
    known = np.isfinite(phase) if phase_y is None else np.isfinite(phase) & np.isfinite(phase_y)
    sprayed: Mask = job.chain.array("calibrate-geometry", "sprayed")
    glass = job.region("glass", glass_station(job, station))
    direct = _spread(known & shrink(glass))
    mirrored = _spread(known & ~grow(sprayed | glass))
    chosen = np.concatenate([direct, mirrored])
    return StageView(
        stage1_mm=station.stage1_mm,
        directions=directions[chosen],
        reflected=np.arange(chosen.size) >= direct.size,
        phase_rad=phase.reshape(-1)[chosen].astype(np.float64),
        phase_y_rad=None if phase_y is None else phase_y.reshape(-1)[chosen].astype(np.float64),
    )


def _spread(mask: Mask) -> NDArray[np.intp]:
    """Pixels of a mask, in random order of a fixed seed: a regular grid would meet the fringes' own ripple."""
    places = np.flatnonzero(mask)
    return np.random.default_rng(0).permutation(places)[:_SAMPLED_PX]


def _optics(job: Job) -> tuple[Intrinsics, RigGeometry, float, float]:
    """Camera, geometry with the position of stage1 at which it was taken, and one sigma of the plate's tilt."""
    try:
        camera = CameraResult.read(job.chain.content("calibrate-camera"))
        board = next(board for board in camera.camera.boards if board.view == camera.plate_view)
        content = job.chain.content("calibrate-geometry")
        return camera.camera.intrinsics, read_geometry(content), float(content["stage1_mm"]), board.sigma_tilt_rad
    except (KeyError, TypeError, ValueError) as error:
        raise Refused(f"the calibration of camera or geometry is damaged: {error!r}", "make it again") from None


def _frame_sigma(geometry: RigGeometry) -> NDArray[np.float64]:
    """One sigma of the mirror's normal about which the drift is told, along x and y of M, rad."""
    mirror = geometry.mirror
    covariance = mirror.covariance * mirror.distance_mm**2
    axes = geometry.frame.axes[:2]
    return np.asarray(np.sqrt(np.diag(axes @ covariance @ axes.T)))


def _axis_words(drift: NDArray[np.float64], sigma: NDArray[np.float64], found: StageAxis, *, with_y: bool) -> str:
    shift = 100 * drift
    words = (
        f"When stage1 goes 100 mm away from the glass it shifts by {shift[0]:+.3f} mm along x (sigma "
        f"{100 * sigma[0]:.3f})"
    )
    words += f" and {shift[1]:+.3f} mm along y (sigma {100 * sigma[1]:.3f})" if with_y else ""
    words += (
        f" against the mirror's normal: {np.rad2deg(drift[0]):+.3f} deg"
        + (f" and {np.rad2deg(drift[1]):+.3f} deg" if with_y else "")
        + ". To set the mirror square to the stage, turn mirror and camera together"
        f" about y by {-np.rad2deg(drift[0]):+.3f} deg"
        + (f" and about x by {np.rad2deg(drift[1]):+.3f} deg" if with_y else "")
        + f" (right-handed). Scale against the calibrated geometry: {found.scale:.5f} (sigma {found.sigma_scale:.5f})."
    )
    return words if with_y else words + " Without fringes along y the shift along y is not known."


def _axis_content(found: StageAxis, drift: NDArray[np.float64], sigma: NDArray[np.float64]) -> Content:
    return {
        "axis": found.axis.tolist(),
        "axis_is": "unit vector in frame M along which frame M moves as s grows; (0, 0, -1) is the mirror's normal",
        "drift": drift.tolist(),
        "drift_is": "shift along x and y of M for each mm away from the glass",
        "sigma_drift": sigma.tolist(),
        "sigma_drift_random": list(found.sigma_rad),
        "scale": found.scale,
        "sigma_scale": found.sigma_scale,
        "scale_is": "length of the motion by the calibrated geometry over that by the stage",
        "positions_mm": list(found.positions_mm),
        "displacements_mm": found.displacements_mm.tolist(),
        "off_line_um": (1e3 * found.off_line_mm).tolist(),
        "rms_rad": found.rms_rad,
        "glass": list(found.glass),
        "glass_is": "a, b, c of z = a x + b y + c in frame M, as the same phases show it",
    }


def _timed(job: Job, label: str, role: str) -> list[ManifestEntry]:
    entries = [entry for entry in job.entries if entry.label == label and entry.role == role]
    if len(entries) < 3:
        raise FramesUnusable(
            f"there are {len(entries)} {role} frames labelled {label!r}; 3 are needed", "measure again"
        )
    return entries


def _after_s(entry: ManifestEntry) -> float:
    value = entry.checks.get("after_s")
    if not isinstance(value, float | int):
        raise FramesUnusable(f"{entry.path}: its time is not known", "give checks.after_s in the manifest")
    return float(value)
