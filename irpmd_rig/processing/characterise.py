"""What the instruments do, from a run's frames: gamma, focus, exposure; the rest is in `characterise_motion`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from irpmd_rig.core import wrapped_phases
from irpmd_rig.core.preparation.exposure import exposure_curve
from irpmd_rig.core.preparation.focus import sharpness
from irpmd_rig.core.preparation.gamma import measure_gamma
from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.characterise_motion import delay_run, settle_run, stage_axis_run
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError
from irpmd_rig.processing.frames import read_frame, read_fringes
from irpmd_rig.processing.job import Job, known_number, size_of
from irpmd_rig.processing.phases import check_station
from irpmd_rig.processing.preparing import write_findings
from irpmd_rig.processing.values import ProcessedRun

_SHARP_PX = 1.0  # of the projector: what a lens in focus and the pixels themselves leave
_LINEAR_SHARE = 0.01


def characterise_run(job: Job) -> ProcessedRun:
    """Compute what the recipe says under ``what``.

    Raises
    ------
    ProcessingError
        If the record does not say what is characterised.
    FramesUnusable, Refused, MeasurementError
        As each of them.
    """
    what = job.record.recipe.get("what")
    if not isinstance(what, str) or what not in _RUNS:
        raise ProcessingError(
            f"what is characterised is not known: {what!r}", f"give recipe.what in run.yaml: {', '.join(_RUNS)}"
        )
    return _RUNS[what](job)


def _gamma_run(job: Job) -> ProcessedRun:
    """Response of the projector and the table that makes it linear, from the fringes labelled ``gamma``."""
    (station, *others) = job.stations("gamma")
    if others:
        raise FramesUnusable("fringes labelled 'gamma' are there more than once", "measure again")
    job.plan(3)
    job.step("phase")
    phase = job.phase(station, take=True)
    checks = check_station(job.folder, station, job.step)
    job.release()
    job.step("light against level")
    found = measure_gamma(read_fringes(job.folder, station), station.counts, phase.phase_rad)
    left = 100 * found.rms
    words = (
        f"The light follows the level with a gamma of {found.gamma:.4f} (sigma {found.sigma_gamma:.4f}); it "
        f"differs from that law by {left:.2f} % of full light (rms). Recipes that say compensation: {job.folder.id} "
        "show fringes whose light is sinusoidal. The camera is taken to be linear: see what: exposure."
    )
    content: Content = {
        "gamma": found.gamma,
        "sigma_gamma": found.sigma_gamma,
        "rms": found.rms,
        "levels": found.levels.tolist(),
        "light": found.light.tolist(),
        "sigma_light": found.sigma.tolist(),
        "table": found.table.tolist(),
        "table_is": "level to show in place of each level, so that the light is linear in the level that was meant",
        "pixels": found.pixels,
        "station": {**checks, **phase.quality()},
    }
    write_findings(job, phase.size_px, words, content)
    return job.finished(words=words, gamma=found.gamma, sigma_gamma=found.sigma_gamma)


def _focus_run(job: Job) -> ProcessedRun:
    """Contrast of fringes of several widths, labelled ``focus``."""
    station = job.stations("focus")[0]
    job.plan(2)
    job.step("contrast of the fringes")
    modulation = wrapped_phases(read_fringes(job.folder, station)).modulation_dn
    found = sharpness(modulation, station.counts)
    blur_px = found.blur * job.facts.projector.size_px[0]
    cells_px = found.blur_cells * job.facts.projector.size_px[0]
    finest = 100 * found.contrast[-1]
    state = "in focus" if blur_px <= _SHARP_PX else "not in focus"
    words = (
        f"Projector and camera together are {state}: a blur of {blur_px:.2f} projector pixels (rms); {finest:.0f} % of "
        f"the contrast of {found.counts[0]:g} fringes are left at {found.counts[-1]:g}. Worst part of the picture: "
        f"{np.nanmax(cells_px):.2f}, best {np.nanmin(cells_px):.2f}. Turn a lens, measure again, and keep what is less."
    )
    content: Content = {
        "counts": list(found.counts),
        "contrast": found.contrast.tolist(),
        "blur_px": blur_px,
        "blur_is": "standard deviation of a Gaussian, in pixels of the projector; camera and projector together",
        "blur_cells_px": [[known_number(float(value)) for value in row] for row in cells_px],
    }
    write_findings(job, size_of(modulation.shape[1:]), words, content)
    return job.finished(words=words, blur_px=blur_px, contrast=[float(value) for value in found.contrast])


def _exposure_run(job: Job) -> ProcessedRun:
    """Brightness of the white frames labelled ``exposure``, two at each exposure."""
    entries = [entry for entry in job.entries if entry.label == "exposure" and entry.role == "white"]
    entries.sort(key=lambda entry: -1 if entry.view is None else entry.view)
    exposures = [entry.exposure_us for entry in entries[::2]]
    if len(entries) < 2 or len(entries) % 2 or any(exposure is None for exposure in exposures):
        raise FramesUnusable(
            "two white frames labelled 'exposure' with their exposure_us are needed at each exposure", "measure again"
        )
    job.plan(2)
    job.step(f"{len(exposures)} exposures")
    frames = [read_frame(job.folder, entry) for entry in entries]
    bits = entries[0].bits or 8 * frames[0].dtype.itemsize
    pairs = list(zip(frames[::2], frames[1::2], strict=True))
    found = exposure_curve(pairs, [float(exposure or 0.0) for exposure in exposures], float(2**bits - 1))
    content: Content = {
        "exposures_us": found.exposures_us.tolist(),
        "bright": found.bright.tolist(),
        "bright_is": "value that 99.5 % of the pixels do not pass, as a share of full scale",
        "saturated": found.saturated.tolist(),
        "recommended_us": known_number(found.recommended_us),
        "nonlinearity": known_number(found.nonlinearity),
        "noise_floor_dn": known_number(found.noise_floor_dn),
        "shot_dn": known_number(found.shot_dn),
    }
    words = _exposure_words(found.recommended_us, found.nonlinearity, found.noise_floor_dn)
    write_findings(job, size_of(frames[0].shape), words, content)
    return job.finished(words=words, recommended_us=found.recommended_us, nonlinearity=found.nonlinearity)


def _exposure_words(recommended_us: float, nonlinearity: float, noise_floor_dn: float) -> str:
    parts = []
    if np.isfinite(recommended_us):
        parts.append(f"At {recommended_us:.0f} us the brightest parts reach 85 % of full scale.")
    else:
        parts.append(
            "No exposure can be recommended: all are too bright, or the light does not grow with them. Give shorter "
            "ones, dim the light, and see that it does not flash."
        )
    if np.isfinite(nonlinearity):
        state = "linear" if nonlinearity <= _LINEAR_SHARE else "not linear"
        parts.append(f"The camera is {state}: {100 * nonlinearity:.2f} % off a straight line at most.")
    else:
        parts.append("Whether the camera is linear cannot be told: three exposures that are not too bright are needed.")
    if np.isfinite(noise_floor_dn):
        parts.append(f"Noise without light: {noise_floor_dn:.2f} DN.")
    return " ".join(parts)


_RUNS: Mapping[str, Callable[[Job], ProcessedRun]] = {
    "gamma": _gamma_run,
    "delay": delay_run,
    "settle": settle_run,
    "stage-axis": stage_axis_run,
    "focus": _focus_run,
    "exposure": _exposure_run,
}
