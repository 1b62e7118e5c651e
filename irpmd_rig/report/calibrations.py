"""Reports of calibrations, references and free sequences."""

from __future__ import annotations

import numpy as np

from irpmd_rig.core import Intrinsics
from irpmd_rig.core.camera import rays_at
from irpmd_rig.report.content import Block, Facts, Picture, Section, Text, Verdict
from irpmd_rig.report.figures_graphs import Series, bars, curves
from irpmd_rig.report.figures_maps import Panel, maps
from irpmd_rig.report.reading import Content, Run
from irpmd_rig.report.rig_model import rig_model_sections
from irpmd_rig.report.taking import contact_sheet, frame_section, stations_table, used_section
from irpmd_rig.report.wording import fixed, listed, micrometres, number, percent, with_sigma
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import StoreError

_DISTORTION = ("k1", "k2", "p1", "p2", "k3")
_MAP_PX = 200


def camera(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Intrinsics, pixel errors, boards."""
    content = run.content or {}
    lens, boards = content["intrinsics"], content["boards"]
    missed = content["missed_views"]
    found = f"{len(boards)} boards found" + (f", not found in {len(missed)} pictures" if missed else " in all pictures")
    fx, fy = (with_sigma(v, s) for v, s in zip(lens["focal_px"], lens["sigma_focal_px"], strict=True))
    verdict = Verdict(True, f"fx {fx} px, fy {fy} px", f"± is one standard deviation. {found}.")
    places = (
        ("fx", "focal_px", 0),
        ("fy", "focal_px", 1),
        ("cx", "principal_point_px", 0),
        ("cy", "principal_point_px", 1),
    )
    rows = [(f"{name} (px)", with_sigma(lens[key][k], lens[f"sigma_{key}"][k])) for name, key, k in places]
    pairs = zip(_DISTORTION, lens["distortion"], lens["sigma_distortion"], strict=True)
    rows += [(name, with_sigma(value, sigma) if sigma > 0 else f"{value:g} (held)") for name, value, sigma in pairs]
    rows.append(("pixel error, columns and rows (px)", listed(lens["pixel_error_px"], 3)))
    views = [str(board["view"] + 1) for board in boards]
    error = bars(views, [board["rms_px"] for board in boards], y_label="rms (px)", x_label="pose")
    blocks: tuple[Block, ...] = (
        Facts(tuple(rows)),
        Picture("pixel_error", error, "Reprojection error of each board.", "Reprojection error of each board, rms."),
        _distortion_picture(lens),
    )
    taken = [entry for entry in run.entries if entry.label == "board"]
    sheet = contact_sheet(run, taken, "frames", "frames of the checkerboard")
    return verdict, (Section("Lens", blocks), Section("Frames", sheet))


def _distortion_picture(lens: Content) -> Picture:
    """How far the lens shifts each pixel from where a pinhole would see it."""
    intrinsics = Intrinsics(*(tuple(lens[key]) for key in ("size_px", "focal_px", "principal_point_px", "distortion")))
    width, height = intrinsics.size_px
    stride = max(1, max(width, height) // _MAP_PX)
    pixels = np.stack(np.meshgrid(np.arange(0.0, width, stride), np.arange(0.0, height, stride)), axis=-1)
    straight = rays_at(intrinsics, pixels)[..., :2] * intrinsics.focal_px + intrinsics.principal_point_px
    shift = np.linalg.norm(straight - pixels, axis=-1)
    window = slice(0, height), slice(0, width)
    figure = maps([Panel("shift by the lens", shift)], unit="px", colours="height", window=window)
    return Picture("distortion", figure, "Map of the lens distortion.", "How far the distortion shifts each pixel.")


def plate(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """The polynomials from phase to plate position."""
    content = run.content or {}
    residuals, order = content["residuals"], content["order"]
    chosen = next(residual for residual in residuals if residual["order"] == order)
    verdict = Verdict(
        True,
        f"Polynomials of order {order}, residual {micrometres(chosen['pixel_um'])} µm a pixel",
        f"At {percent(content['valid_fraction'])} of the pixels; {micrometres(chosen['coherent_um'])} µm is no noise.",
    )
    series = [
        Series("a pixel", [residual["pixel_um"] for residual in residuals]),
        Series("not noise", [residual["coherent_um"] for residual in residuals]),
    ]
    orders = [residual["order"] for residual in residuals]
    figure = curves(orders, series, x_label="order", y_label="residual (µm)", log_y=True)
    caption = f"What polynomials of each order leave; order {order} was chosen."
    blocks: list[Block] = [
        Facts((("positions of stage 2 (mm)", listed(content["positions_mm"], 4)),)),
        Picture("order", figure, "Residual of the polynomials against their order.", caption),
    ]
    sections = [Section("Phase to position", tuple(blocks)), frame_section(run, "plate"), _how(run), used_section(run)]
    return verdict, tuple(section for section in sections if section is not None)


def geometry(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Planes, d, angles; and the self-calibrated rig model where it was taken at several positions."""
    content = run.content or {}
    model: Content | None = content.get("rig_model")
    told = f"Tilt of the glass against the reference {fixed(content['gamma_deg'], 3)} degrees."
    if model is not None:
        told += f" Rig model: χ² {number(model['chi2_per_dof'])} a degree of freedom."
    verdict = Verdict(True, f"d {with_sigma(content['d_mm'], content['sigma_d_mm'])} mm", told)
    angles = ", ".join(fixed(content[name], 3) for name in ("alpha_deg", "beta_deg", "gamma_deg"))
    rows = (
        ("d along the reference's normal (mm)", with_sigma(content["d_mm"], content["sigma_d_mm"])),
        ("taken with stage 1 at (mm)", number(content["stage1_mm"], 6)),
        ("d, mean over the seen glass (mm)", fixed(content["d_seen_mean_mm"], 4)),
        ("alpha, beta, gamma of the planes (degrees)", angles),
        ("camera in frame M (mm)", listed(content["camera_mm"])),
        ("plane of the mirror: rms (µm), pixels", _plane(content["mirror"])),
        ("plane of the glass: rms (µm), pixels", _plane(content["glass"])),
    )
    parts: dict[str, float] = content["sigma_parts_um"]
    figure = bars(list(parts), list(parts.values()), y_label="one sigma (µm)")
    blocks: list[Block] = [
        Facts(rows),
        Picture("d_uncertainty", figure, "Parts of the uncertainty of d.", "Where the uncertainty of d comes from."),
    ]
    regions = _regions(run)
    if regions is not None:
        blocks.append(regions)
    sections = [
        Section("Planes and distance", tuple(blocks)),
        *(() if model is None else rig_model_sections(run, model)),
        frame_section(run, "mirror"),
        Section(
            "Frames of sprayed mirror and glass", contact_sheet(run, _lit(run), "lit_frames", "white and black frames")
        ),
        _how(run),
        used_section(run),
    ]
    return verdict, tuple(section for section in sections if section is not None)


def _plane(plane: Content) -> str:
    return f"{micrometres(1e3 * plane['rms_mm'])}, {plane['pixels']}"


def _lit(run: Run) -> list[ManifestEntry]:
    return [entry for entry in run.entries if entry.role in ("white", "black")]


def _regions(run: Run) -> Picture | None:
    try:
        with np.load(run.folder.results.path("arrays.npz"), allow_pickle=False) as arrays:
            sprayed, glass = arrays["sprayed"], arrays["glass"]
    except (StoreError, OSError, ValueError, KeyError):
        return None
    labels = np.where(sprayed, 1, np.where(glass, 2, 0))
    figure = maps([Panel("where what is seen", labels)], unit="1 sprayed, 2 glass", colours="facets")
    caption = "Where the sprayed mirror (1) and the glass seen directly (2) were found."
    return Picture("regions", figure, "Regions of the sprayed mirror and of the glass in the picture.", caption)


def reference(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Phases of the reference mirror."""
    content = run.content or {}
    where = listed(content["positions_mm"])
    noise = [station["noise_rad"] for station in content["stations"] if station.get("noise_rad") is not None]
    told = f"Noise of a pixel's phase {number(1e3 * max(noise))} mrad before smoothing." if noise else ""
    verdict = Verdict(True, f"Reference at {where} mm", told)
    panels = []
    try:
        with np.load(run.folder.results.path("arrays.npz"), allow_pickle=False) as arrays:
            for place, position in enumerate(content["positions_mm"], 1):
                phase = arrays[f"position_{place}_rad"]
                stride = max(1, max(phase.shape) // 420)
                size = phase.shape
                panels.append(Panel(f"stage 1 at {position:.4g} mm", phase[::stride, ::stride].copy()))
    except (StoreError, OSError, ValueError, KeyError):
        panels = []
    blocks: tuple[Block, ...] = (Text("The arrays are not there, or damaged."),)
    if panels:
        window = slice(0, size[0]), slice(0, size[1])
        figure = maps(panels, unit="absolute phase (rad)", colours="height", window=window)
        blocks = (Picture("reference_phase", figure, "Smoothed phase of the reference mirror.", "Smoothed phase."),)
    sections = [Section("Phase of the reference", blocks), frame_section(run, "mirror"), _how(run), used_section(run)]
    return verdict, tuple(section for section in sections if section is not None)


def _how(run: Run) -> Section | None:
    table = stations_table(run)
    return None if table is None else Section("How it was taken", (table,))


def other(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Frames, and whatever was computed: of kinds that have no report of their own."""
    content = run.content or {}
    rows = tuple(_scalars(content))
    verdict = Verdict(None, f"{run.record.kind}: {len(run.entries)} frames")
    blocks: tuple[Block, ...] = (Facts(rows),) if rows else ()
    sections = [
        Section("What was found", blocks) if blocks else None,
        Section("Frames", contact_sheet(run, run.entries, "frames", "frames") or (Text("There are no frames."),)),
        used_section(run),
    ]
    return verdict, tuple(section for section in sections if section is not None)


_SAID = ("kind", "run", "created", "computed", "units", "camera_serial", "size_px", "uses", "versions")


def _scalars(content: Content) -> list[tuple[str, str]]:
    rows = []
    for name, value in content.items():
        if name in _SAID:
            continue
        if isinstance(value, bool | str) and value != "":
            rows.append((name, str(value)))
        elif isinstance(value, int | float):
            rows.append((name, number(float(value), 6)))
        elif isinstance(value, list) and value and all(isinstance(v, int | float) for v in value) and len(value) <= 40:
            rows.append((name, listed(value)))
    return rows


__all__ = ["camera", "geometry", "other", "plate", "reference"]
