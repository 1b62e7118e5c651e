"""Parts of a report that all kinds of runs have: how it was taken, frames, what was used, versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import decode, wrapped_phases
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.report.content import Block, Facts, Files, Picture, Section, Source, Table, Text
from irpmd_rig.report.figures_maps import Panel, Window, maps
from irpmd_rig.report.reading import Content, FringeSets, Run, fringe_sets, thin_frames
from irpmd_rig.report.wording import MISSING, days_between, fixed, listed, moment, number, percent, with_sigma
from irpmd_rig.store.entries import ManifestEntry

T = TypeVar("T")

_LIT = 0.1  # of the brightest parts: where a wrapped phase says something
_FRAMES = 12  # that a report shows of one kind
_POSITIONS = 6  # of the stage, at which phases are shown
_GONE = "The frames are not in the folder any more."


def frame_section(run: Run, label: str, window: Window | None = None) -> Section:
    """First frame of every fringe set, wrapped phases at the first station, absolute phase at each.

    Parameters
    ----------
    run
        The run.
    label
        What stood before the camera.
    window
        Rows and columns of the picture that wrapped phases are shown of, so that single fringes can be told apart.
    """
    heading = "Frames and phases"
    sets = fringe_sets(run.entries, label)
    blocks: list[Block] = []
    if sets:
        first = sets[0]
        titles = [f"{count:g} fringes" for count in first.counts]
        frames = thin_frames(run.folder, first.entries)
        if frames is None:
            return Section(heading, (Text(_GONE),))
        stack = frames.reshape(len(first.counts), first.steps, *frames.shape[1:])
        panels = [Panel(f"{title}, step 1", step_1) for title, step_1 in zip(titles, stack[:, 0], strict=True)]
        blocks.append(
            Picture(
                "frames",
                maps(panels, unit="frame (DN)", colours="grey", window=_whole(run)),
                f"Camera frames of {label}, the first phase step of each fringe set.",
                f"First frame of each set at {_place(first)}.",
            )
        )
        close = thin_frames(run.folder, first.entries, window)
        assert close is not None  # they were read just now
        phases = _wrapped(close.reshape(len(first.counts), first.steps, *close.shape[1:]))
        panels = [Panel(title, phase) for title, phase in zip(titles, phases, strict=True)]
        blocks.append(
            Picture(
                "wrapped_phase",
                maps(panels, unit="wrapped phase (rad)", colours="phase", window=window or _whole(run)),
                "Wrapped phase of each fringe set; grey where too little light comes back.",
                f"Wrapped phase of each set at {_place(first)}.",
            )
        )
    absolute = _absolute(run, (*sets, *fringe_sets(run.entries, label, "y")))
    if absolute:
        blocks.append(
            Picture(
                "absolute_phase",
                maps(absolute, unit="absolute phase (rad)", colours="height", window=_whole(run)),
                "Absolute phase at each stage position; grey where it is not known.",
                "Absolute phase of the finest set.",
            )
        )
    return Section(heading, tuple(blocks) or (Text("No set of fringes is complete."),))


def _wrapped(stack: NDArray[Any]) -> NDArray[np.float32]:
    wrapped = wrapped_phases(stack)
    lit = wrapped.modulation_dn > _LIT * np.nanpercentile(wrapped.modulation_dn, 99)
    return np.where(lit, wrapped.phase_rad, np.float32(np.nan))


def _absolute(run: Run, sets: Sequence[FringeSets]) -> list[Panel]:
    panels = []
    for one in _some(sets, _POSITIONS):
        frames = thin_frames(run.folder, one.entries)
        if frames is None:
            continue
        stack = frames.reshape(len(one.counts), one.steps, *frames.shape[1:])
        bits = one.entries[0].bits
        try:
            phase = decode(
                stack,
                one.counts,
                unwrapping=one.unwrapping,
                saturation_dn=None if bits is None else float(2**bits - 1),
            )
        except MeasurementError:
            # What cannot be decoded failed the run, which says so; its frames are shown all the same.
            continue
        axis = "" if one.orientation == "x" else f", fringes along {one.orientation}"
        panels.append(Panel(f"{_place(one)}{axis}", phase.phase_rad))
    return panels


def contact_sheet(run: Run, entries: Sequence[ManifestEntry], name: str, what: str) -> tuple[Block, ...]:
    """Some frames side by side: evenly chosen where there are many."""
    if not entries:
        return ()
    chosen = _some(entries, _FRAMES)
    frames = thin_frames(run.folder, chosen)
    if frames is None:
        return (Text(_GONE),)
    thin = max(1, frames.shape[1] // 210)
    panels = [Panel(_titled(entry), frame[::thin, ::thin]) for entry, frame in zip(chosen, frames, strict=True)]
    caption = (
        f"{len(chosen)} of {len(entries)} {what}." if len(chosen) < len(entries) else f"{what[:1].upper()}{what[1:]}."
    )
    figure = maps(panels, unit="frame (DN)", colours="grey", window=_whole(run))
    return (Picture(name, figure, f"Camera frames: {what}.", caption),)


def _some(all_: Sequence[T], most: int) -> list[T]:
    """All of them, or so many, evenly chosen."""
    return [all_[k] for k in sorted({round(place) for place in np.linspace(0, len(all_) - 1, min(most, len(all_)))})]


def _titled(entry: ManifestEntry) -> str:
    parts = [entry.label, "" if entry.role == "plain" else entry.role]
    if entry.view is not None:
        parts.append(f"pose {entry.view + 1}")
    if entry.set is not None and entry.step is not None:
        parts.append(f"{entry.set + 1}.{entry.step + 1}")
    if entry.stage2_mm and entry.label == "plate":
        parts.append(f"at {entry.stage2_mm:g} mm")
    return " ".join(part for part in parts if part)


def _place(sets: FringeSets) -> str:
    entry = sets.entries[0]
    if sets.label == "plate":
        return "stage 2 unknown" if entry.stage2_mm is None else f"stage 2 at {entry.stage2_mm:.4g} mm"
    return f"station {entry.station}" if entry.stage1_mm is None else f"stage 1 at {entry.stage1_mm:.4g} mm"


def _whole(run: Run) -> tuple[slice, slice] | None:
    """Rows and columns of a whole frame, for the axes of a picture that was made thin."""
    size = (run.content or {}).get("size_px") or (run.record.optics.size_px if run.record.optics else None)
    return None if size is None else (slice(0, int(size[1])), slice(0, int(size[0])))


def stations_table(run: Run) -> Table | None:
    """Where each set of fringes was taken, with what light, and what it is worth."""
    content = run.content or {}
    stations: list[Content] = content.get("positions") or content.get("stations") or []
    if not stations or not all(isinstance(station, dict) for station in stations):
        return None
    rows = []
    for station in stations:
        checks = station.get("checks") or station
        entry = next((e for e in run.entries if e.station == station.get("station") and e.role == "fringes"), None)
        rows.append(
            (
                str(station.get("station", "")),
                station.get("label") or (entry.label if entry else ""),
                fixed(entry.stage1_mm if entry else station.get("stage1_mm"), 4),
                fixed(entry.stage2_mm if entry else None, 3),
                number(entry.exposure_us if entry else None, 4),
                number(checks.get("noise_dn")),
                number(station.get("modulation_dn")) if not isinstance(station.get("modulation_dn"), list) else MISSING,
                number(1e3 * station["sigma_rad"]) if station.get("sigma_rad") is not None else MISSING,
                percent(station.get("valid_fraction")),
            )
        )
    columns = (
        "station", "label", "stage 1 (mm)", "stage 2 (mm)", "exposure (µs)", "noise (DN)", "modulation (DN)",
        "phase noise (mrad)", "decoded",
    )  # fmt: skip
    return Table(columns, tuple(rows), "Stations; noise and modulation as measured from the frames, medians")


def used_section(run: Run) -> Section | None:
    """Calibrations and reference that went into the run."""
    uses: dict[str, str] = (run.content or {}).get("uses") or {}
    if not uses:
        return None
    rows = []
    for kind, run_id in uses.items():
        content = run.used.get(kind)
        created = None if content is None else content.get("created")
        age = days_between(created, (run.content or {}).get("created"))
        told = "its folder is not at hand" if content is None else _found(kind, content)
        rows.append((kind, run_id, moment(created), MISSING if age is None else f"{age:.2f}", told))
    table = Table(("kind", "run", "taken", "days before", "what it found"), tuple(rows))
    return Section("Calibrations used", (table,))


def _found(kind: str, content: Content) -> str:
    """What a calibration found; one that a script wrote need not say all that ours do."""
    try:
        return key_figure(kind, content)
    except (KeyError, TypeError, ValueError, IndexError):
        return MISSING


def key_figure(kind: str, content: Content) -> str:
    """What a calibration or a reference found, in one line."""
    if kind == "calibrate-camera":
        lens = content["intrinsics"]
        return f"fx {with_sigma(lens['focal_px'][0], lens['sigma_focal_px'][0])} px, {len(content['boards'])} boards"
    if kind == "calibrate-plate":
        return f"polynomials of order {content['order']} at {percent(content['valid_fraction'])} of the pixels"
    if kind == "calibrate-geometry":
        model = content.get("rig_model")
        chi2 = "" if model is None else f"; rig model, χ² {number(model['chi2_per_dof'])} a degree of freedom"
        return f"d {with_sigma(content['d_mm'], content['sigma_d_mm'])} mm{chi2}"
    if kind == "reference":
        return f"stage 1 at {listed(content['positions_mm'])} mm"
    return ""


def origin_section(run: Run, pictures: Sequence[str]) -> Section:
    """Who, when, with what: all that tells this run from another; ``pictures`` are written beside the page."""
    record, content = run.record, run.content or {}
    rig_name = record.rig.get("name") if isinstance(record.rig, dict) else None
    rows = [
        ("run", run.folder.id),
        ("kind", record.kind),
        ("operator", record.operator),
        ("sample", record.sample),
        ("notes", record.notes),
        ("taken", moment(record.created.isoformat() if record.created else None)),
        ("computed", moment(content.get("computed"))),
        ("rig", str(rig_name or "")),
        ("camera", content.get("camera_serial") or (record.optics.camera_serial if record.optics else "")),
        ("frames", str(len(run.entries))),
    ]
    blocks: list[Block] = [Facts(tuple((name, value) for name, value in rows if value not in ("", MISSING)))]
    taken, computed = record.versions, content.get("versions") or {}
    names = sorted({*taken, *computed})
    if names:
        versions = tuple((name, taken.get(name, MISSING), computed.get(name, MISSING)) for name in names)
        blocks.append(Table(("software", "taken with", "computed with"), versions))
    files = {*run.folder.results.names(), *pictures} - {"report.html"}
    if files:
        blocks += [Text("Files beside this page:"), Files(tuple(sorted(files)))]
    recipe = run.folder.recipe_text()
    if recipe:
        blocks += [Text("The recipe as it was given:"), Source(recipe)]
    return Section("Origin and versions", tuple(blocks))
