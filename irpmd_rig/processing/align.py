"""Parallelism of ground glass and mirror from a run's frames, and what the operator is to turn."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import place_plate, rays
from irpmd_rig.core.preparation.alignment import GlassTilt, SeenPlanes, glass_tilt
from irpmd_rig.processing.archive import CameraResult, Content, read_relation
from irpmd_rig.processing.errors import Refused
from irpmd_rig.processing.job import Job, size_of
from irpmd_rig.processing.preparing import write_findings
from irpmd_rig.processing.regions import Mask, shrink
from irpmd_rig.processing.values import ProcessedRun, Summary
from irpmd_rig.processing.wishes import align_wishes

ASK = "ask"
"""Key of a summary: what the operator is asked before the run goes on; not there if it need not."""
LEFT = "left"
"""Key of a summary: what is still out of tolerance after the last round, and what to do; not there if nothing is."""

_UNSURE = (
    " That is less certain than the tolerance asks for: it hangs on the board that lay on the white plate when the "
    "camera was calibrated; calibrate the camera again with that board turned by some 20 deg in its plane."
)
# Nobody turns a screw more finely, and the text that he reads says no more.
_DIGITS = 3


def align_run(job: Job) -> ProcessedRun:
    """Tilt of the glass in every round so far: white and black frames ``sprayed`` and ``glass``, fringes ``mirror``.

    While the glass is out of tolerance the summary holds `ASK` and the turns that it asks for if rounds are left, and
    `LEFT` if none are.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If the calibrations of camera and plate do not fit.
    ProcessingError
        If the recipe part of the record is wrong.
    MeasurementError
        As `irpmd_rig.core.preparation.alignment.glass_tilt`.
    """
    asked_for, stations = align_wishes(job.record), job.stations("mirror")
    job.chain.check_fringes(stations[0].counts)
    job.plan(len(stations) + 1)
    job.step("where the sprayed mirror and the glass are seen")
    regions = shrink(job.region("sprayed")), shrink(job.region("glass"))
    tilts = []
    for number, station in enumerate(stations, 1):
        job.step(f"tilt of the glass, round {number}")
        phase = job.phase(station, take=True)
        tilts.append(_glass_tilt(job, phase.phase_rad, regions))
    tolerance_rad = float(np.deg2rad(asked_for.tolerance_deg))
    aligned = tilts[-1].within(tolerance_rad)
    turns = _turns_deg(tilts[-1], tolerance_rad)
    over = aligned or len(tilts) >= asked_for.rounds
    words = f"Round {len(tilts)} of at most {asked_for.rounds}. {_words(tilts[-1], tolerance_rad)}"
    content: Content = {
        "is": "tilt of the ground glass against the mirror: turns about x and y of frame M, right-handed",
        "tolerance_deg": asked_for.tolerance_deg,
        "of_round": len(tilts),
        "rounds_at_most": asked_for.rounds,
        "over": over,
        "over_is": "whether this was the last round: otherwise the glass may have been turned since, and not measured",
        "rounds": [_round(tilt) for tilt in tilts],
        "aligned": aligned,
        "next": None if aligned else instruction(turns),
    }
    write_findings(job, size_of(regions[0].shape), words, content)
    asked: dict[str, Summary] = {}
    if not over:
        asked = {ASK: instruction(turns), "turn_about_x_deg": turns[0], "turn_about_y_deg": turns[1]}
    elif not aligned:
        asked = {LEFT: f"{words} {instruction(turns)} Then run it again, or with a larger tolerance."}
    return job.finished(
        words=words,
        aligned=int(aligned),
        tilt_about_x_deg=float(np.rad2deg(tilts[-1].about_x_rad)),
        tilt_about_y_deg=float(np.rad2deg(tilts[-1].about_y_rad)),
        rounds=len(tilts),
        **asked,
    )


def instruction(turns_deg: tuple[float, float]) -> str:
    """Tell a person which way and how much to turn the glass, in degrees about x and about y."""
    about_x, about_y = turns_deg
    parts = []
    if about_y:
        way = "toward the mirror" if about_y > 0 else "away from the mirror"
        parts.append(f"its +x side {way} by {_rise_mm(about_y):.2f} mm a 100 mm (about y by {about_y:+.3f} deg)")
    if about_x:
        way = "away from the mirror" if about_x > 0 else "toward the mirror"
        parts.append(f"its +y side {way} by {_rise_mm(about_x):.2f} mm a 100 mm (about x by {about_x:+.3f} deg)")
    return f"Turn the ground glass: {'; '.join(parts)}. Leave the mirror where it is; lamp off."


def _rise_mm(turn_deg: float) -> float:
    return 100 * float(np.tan(np.deg2rad(abs(turn_deg))))


def _turns_deg(tilt: GlassTilt, tolerance_rad: float) -> tuple[float, float]:
    """Turns that take the tilt away about each axis that is out of tolerance."""
    about_x, about_y = (
        round(-float(np.rad2deg(turn)), _DIGITS) if abs(turn) > tolerance_rad else 0.0
        for turn in (tilt.about_x_rad, tilt.about_y_rad)
    )
    return about_x, about_y


def _words(tilt: GlassTilt, tolerance_rad: float) -> str:
    about_x, about_y, sigma_x, sigma_y = np.rad2deg(
        [tilt.about_x_rad, tilt.about_y_rad, tilt.sigma_about_x_rad, tilt.sigma_about_y_rad]
    )
    state = "parallel within the tolerance" if tilt.within(tolerance_rad) else "not parallel within the tolerance"
    unsure = max(tilt.sigma_about_x_rad, tilt.sigma_about_y_rad) > tolerance_rad
    return (
        f"The glass is {state}: it leans by {about_x:+.4f} deg about x (sigma {sigma_x:.4f}) and {about_y:+.4f} deg "
        f"about y (sigma {sigma_y:.4f})." + (_UNSURE if unsure else "")
    )


def _round(tilt: GlassTilt) -> Content:
    return {
        name.replace("_rad", "_deg"): float(np.rad2deg(getattr(tilt, name)))
        for name in ("about_x_rad", "about_y_rad", "sigma_about_x_rad", "sigma_about_y_rad")
    }


def _glass_tilt(job: Job, phase_rad: NDArray[np.float32], regions: tuple[Mask, Mask]) -> GlassTilt:
    """Tilt of the glass by the phase of one round."""
    try:
        result = CameraResult.read(job.chain.content("calibrate-camera"))
        relation = read_relation(job.chain.content("calibrate-plate"), partial(job.chain.array, "calibrate-plate"))
    except (KeyError, TypeError, ValueError) as error:
        raise Refused(f"the calibration of camera or plate is damaged: {error!r}", "make it again") from None
    board = next(board for board in result.camera.boards if board.view == result.plate_view)
    position_mm = relation.position_mm(phase_rad, threads=job.threads)
    return glass_tilt(
        SeenPlanes(position_mm, rays(result.camera.intrinsics), *regions),
        place_plate(board, result.plate_position_mm),
        board.sigma_tilt_rad,
        job.drawing,
    )
