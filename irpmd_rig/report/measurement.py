"""The report of a measurement: first the steps, then what they rest on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from irpmd_rig.report.checks import measurement_checks, summed_up
from irpmd_rig.report.content import Block, Check, Checks, Facts, Picture, Section, Table, Text, Turnable, Verdict
from irpmd_rig.report.figures_graphs import Series, histogram, step_deviations, step_parts
from irpmd_rig.report.figures_maps import Panel, maps
from irpmd_rig.report.figures_surface import surface
from irpmd_rig.report.mesh import mesh_of
from irpmd_rig.report.reading import Content, Run
from irpmd_rig.report.shape import Shape, read_shape
from irpmd_rig.report.taking import frame_section, stations_table, used_section
from irpmd_rig.report.wording import MISSING, fixed, listed, micrometres, number, percent, signed, with_sigma

_PARTS = (("random_um", "random"), ("calibration_um", "calibration"), ("alignment_um", "alignment"))
_LISTED = 6  # steps that a headline names


def measurement(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Verdict and sections of a measurement that was computed."""
    content = run.content or {}
    checks = measurement_checks(run)
    shape = read_shape(run)
    sections = [
        _steps(content),
        Section("Checks", (Checks(checks),)),
        _methods(content),
        None if shape is None else _shape(shape),
        None if shape is None else _residuals(shape, content),
        frame_section(run, "object", None if shape is None else shape.window),
        used_section(run),
        _how(run, content),
    ]
    return _verdict(content, checks), tuple(section for section in sections if section is not None)


def _verdict(content: Content, checks: tuple[Check, ...]) -> Verdict:
    passed, told = summed_up(checks)
    steps = content["steps"]
    if not steps:
        pixels = content.get("depth", {}).get("pixels")
        why = content.get("without_steps") or ""
        why = f"No steps: {why}. " if why else ""
        return Verdict(passed, f"A depth map of {pixels} pixels, {len(content['facets'])} facets", f"{why}{told}")
    values = [with_sigma(step["measured_mm"], _sigma_mm(step)) for step in steps]
    if len(values) <= _LISTED:
        headline = f"Steps: {', '.join(values)} mm" if len(values) > 1 else f"Step: {values[0]} mm"
    else:
        worst = max((step["uncertainty_um"] or 0.0) for step in steps)
        headline = f"{len(steps)} steps, the largest uncertainty {micrometres(worst)} µm"
    return Verdict(passed, headline, f"± is one standard deviation. {told}")


def _sigma_mm(step: Content) -> float | None:
    sigma = step.get("uncertainty_um")
    return None if sigma is None else sigma / 1e3


def _steps(content: Content) -> Section:
    steps: list[Content] = content["steps"]
    method = content.get("method", "")
    because = content.get("method_because")
    told = Text(f"Method: {method}{f', for {because}' if because else ''}.")
    if not steps:
        return Section("Steps", (told, Text(f"No steps: {content.get('without_steps') or 'none were found'}.")))
    blocks: list[Block] = [told, _step_table(steps, content.get("step_definition", "")), *_correlation(content)]
    names = [step["name"] for step in steps]
    if any(step.get("nominal_mm") is not None for step in steps):
        figure = step_deviations(names, [_deviations(method or "measured", steps)], beside="nominal")
        caption = "Measured minus nominal; bars of one and (thin) two standard deviations."
        blocks.append(Picture("steps", figure, "Deviations of the steps from nominal, with error bars.", caption))
    parts = [Series(name, [_of(step, key) for step in steps]) for key, name in _present(steps)]
    if parts:
        caption = "Parts of the uncertainty of each step; the whole is the root of the sum of their squares."
        figure = step_parts(names, parts)
        blocks.append(Picture("step_uncertainty", figure, "Parts of the uncertainty of each step.", caption))
    return Section("Steps", tuple(blocks))


def _correlation(content: Content) -> list[Block]:
    """How far neighbouring steps err together: they share a facet."""
    found = (content.get("methods") or {}).get(content.get("method")) or {}
    covariance = np.array(found.get("step_covariance_um2") or [], dtype=np.float64)
    if covariance.ndim != 2 or len(covariance) < 2:
        return []
    sigma = np.sqrt(np.diag(covariance))
    pairs = [covariance[k, k + 1] / (sigma[k] * sigma[k + 1]) for k in range(len(sigma) - 1)]
    return [Text(f"Correlation of each step's error with the next one's: {', '.join(signed(r, 2) for r in pairs)}.")]


def _present(steps: Sequence[Content]) -> list[tuple[str, str]]:
    return [(key, name) for key, name in _PARTS if any(step.get(key) for step in steps)]


def _of(step: Content, key: str) -> float:
    value = step.get(key)
    return float("nan") if value is None else float(value)


def _deviations(name: str, steps: Sequence[Content]) -> Series:
    return Series(name, [_of(s, "deviation_um") for s in steps], [_of(s, "uncertainty_um") for s in steps])


def _step_table(steps: Sequence[Content], definition: str) -> Table:
    parts = _present(steps)
    nominal = any(step.get("nominal_mm") is not None for step in steps)
    columns = ["step", "height (mm)", "± (µm)", *(f"{name} (µm)" for _, name in parts)]
    columns += ["nominal (mm)", "deviation (µm)", "in sigmas"] if nominal else []
    rows = []
    for step in steps:
        sigma, off = step.get("uncertainty_um"), step.get("deviation_um")
        row = [step["name"], fixed(step["measured_mm"], 4), micrometres(sigma)]
        row += [micrometres(step.get(key)) for key, _ in parts]
        if nominal:
            beside = MISSING if off is None or not sigma else signed(off / sigma, 1)
            row += [fixed(step.get("nominal_mm"), 4), signed(off, 1), beside]
        rows.append(tuple(row))
    return Table(tuple(columns), tuple(rows), definition)


def _methods(content: Content) -> Section | None:
    """All methods that were computed, side by side."""
    methods: dict[str, Content] = content.get("methods") or {}
    missing: dict[str, str] = content.get("not_computed") or {}
    if len(methods) + len(missing) < 2:
        return None
    names = [step["name"] for step in content["steps"]]
    rows, series = [], []
    for name, found in methods.items():
        steps = found.get("steps") or []
        fits = bool(names) and [step["name"] for step in steps] == names
        cells = [with_sigma(s["measured_mm"], _sigma_mm(s)) for s in steps] if fits else [MISSING] * len(names)
        noise = micrometres(found.get("noise_of_a_pixel_um"))
        rows.append((name, *cells, noise, number(found.get("chi2_per_dof")), found.get("without_steps") or ""))
        if fits:
            chosen = [{**s, "deviation_um": _beside(s, one)} for s, one in zip(steps, content["steps"], strict=True)]
            series.append(_deviations(name, chosen))
    rows += [(name, *(MISSING for _ in names), MISSING, MISSING, why) for name, why in missing.items()]
    columns = ("method", *(f"step {name} (mm)" for name in names), "noise of a pixel (µm)", "χ² per d.o.f.", "")
    blocks: list[Block] = [Table(columns, tuple(rows), f"Chosen: {content.get('method', '')}")]
    if len(series) > 1:
        nominal = any(step.get("nominal_mm") is not None for step in content["steps"])
        beside = "nominal" if nominal else "the chosen method"
        figure = step_deviations(names, series, beside=beside)
        caption = f"Each method's steps minus {beside}; bars of one and (thin) two standard deviations."
        blocks.append(Picture("methods", figure, "Steps by each method, with error bars.", caption))
    return Section("Methods compared", tuple(blocks))


def _beside(step: Content, chosen: Content) -> float:
    """Deviation from nominal where that was said, else from the chosen method's step."""
    should = chosen.get("nominal_mm")
    return 1e3 * float(step["measured_mm"] - (chosen["measured_mm"] if should is None else should))


def _shape(shape: Shape) -> Section:
    alt = "The measured surface in perspective, coloured by height."
    labels = shape.labels if (shape.labels > 0).any() else None
    mesh = mesh_of(shape.points_mm, labels, shape.residual_um)
    blocks: list[Block] = []
    if mesh is not None:
        caption = (
            "The measured surface; z is the height above the reference plane, positive toward the glass. Drag or use "
            "the arrow keys to turn it, the wheel or + and - to come closer. Not every pixel is shown."
        )
        blocks.append(Turnable(mesh, Picture("surface", surface(shape.points_mm, labels), alt, caption)))
    figure = maps(
        [Panel("height above the reference", shape.depth_mm)], unit="mm", colours="height", window=shape.window
    )
    blocks.append(Picture("depth", figure, "Depth map: height above the reference plane at every pixel.", "Depth map."))
    if shape.sigma_mm is not None:
        panel = Panel("one sigma of the height", 1e3 * shape.sigma_mm)
        figure = maps([panel], unit="µm", colours="height", window=shape.window)
        alt = "Map of the random uncertainty of the height at every pixel."
        blocks.append(Picture("sigma", figure, alt, "Random part of the uncertainty of the height, one sigma."))
    figure = maps([Panel("facets found", shape.labels)], unit="facet", colours="facets", window=shape.window)
    blocks.append(Picture("facets", figure, "The facets that were found, each in a colour of its own.", "Facets."))
    return Section("Shape", tuple(blocks))


def _residuals(shape: Shape, content: Content) -> Section | None:
    facets: list[Content] = content["facets"]
    if not facets or not np.isfinite(shape.residual_um).any():
        return None
    panel = Panel("height beside the fitted facet", shape.residual_um)
    figure = maps([panel], unit="µm", colours="signed", window=shape.window)
    caption = "Height of each pixel beside the surface fitted to its facet."
    blocks: list[Block] = [
        _facet_table(facets, shape),
        Picture("residuals", figure, "Map of what the fitted facets leave of the height.", caption),
    ]
    noise_um = content.get("depth", {}).get("noise_of_a_pixel_um")
    normal = (0.0, noise_um) if noise_um else None
    figure = histogram(shape.residual_um, x_label="residual (µm)", normal=normal)
    caption = "How often residuals occur" + (
        f"; the line is the noise of a pixel, {micrometres(noise_um)} µm." if noise_um else "."
    )
    blocks.append(Picture("residual_histogram", figure, "Histogram of the residuals.", caption))
    return Section("Residuals to the fitted facets", tuple(blocks))


def _facet_table(facets: Sequence[Content], shape: Shape) -> Table:
    def rms_um(facet: Content) -> float:
        return float(np.sqrt(np.nanmean(shape.residual_um[shape.labels == facet["facet"]].astype(np.float64) ** 2)))

    rows = tuple(
        (
            str(facet["facet"]),
            ", ".join(fixed(place, 2) for place in facet["centre_mm"]),
            with_sigma(
                facet["height_mm"], None if facet.get("sigma_height_um") is None else facet["sigma_height_um"] / 1e3
            ),
            ", ".join(signed(1e3 * slope, 3) for slope in facet["slope_rad"]),
            micrometres(rms_um(facet)),
            number(facet.get("chi2_per_dof")),
            str(facet["pixels"]),
            facet.get("kind") or ("plane" if facet.get("flat", True) else "curved"),
        )
        for facet in facets
    )
    columns = (
        "facet", "centre x, y (mm)", "height there (mm)", "slope along x, y (mrad)", "residual rms (µm)",
        "χ² per d.o.f.", "pixels", "shape",
    )  # fmt: skip
    return Table(columns, rows)


def _how(run: Run, content: Content) -> Section:
    depth = content.get("depth", {})
    rows = [
        ("fringe counts", listed(content.get("counts", ()))),
        ("phase steps a set", str(content.get("steps_a_set", MISSING))),
        ("d at position 1 (mm)", with_sigma(content.get("d_mm"), content.get("sigma_d_mm"))),
        ("travel Δd (mm)", with_sigma(content.get("delta_d_mm"), content.get("sigma_delta_d_mm"))),
        ("pixels with a depth", f"{depth.get('pixels', MISSING)} ({percent(depth.get('fraction_of_picture'))})"),
        ("noise of a pixel's height (µm)", micrometres(depth.get("noise_of_a_pixel_um"))),
    ]
    blocks: list[Block] = [Facts(tuple(row for row in rows if not row[1].startswith(MISSING)))]
    stations = stations_table(run)
    if stations is not None:
        blocks.append(stations)
    return Section("How it was taken", tuple(blocks))
