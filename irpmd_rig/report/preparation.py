"""Reports of runs that prepare the rig: alignment round by round, and what was characterised."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from irpmd_rig.report.content import Block, Facts, Picture, Section, Text, Verdict
from irpmd_rig.report.figures_graphs import Series, curves
from irpmd_rig.report.figures_maps import Panel, maps
from irpmd_rig.report.reading import Content, Run
from irpmd_rig.report.taking import contact_sheet, used_section
from irpmd_rig.report.wording import number, with_sigma

_Found = tuple[Verdict, tuple[Block, ...]]


def align(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """Tilt of the glass in every round, beside the tolerance."""
    content = run.content or {}
    rounds, tolerance = content["rounds"], content["tolerance_deg"]
    last = rounds[-1]
    tilts = " and ".join(f"{with_sigma(last[f'about_{a}_deg'], last[f'sigma_about_{a}_deg'])}° about {a}" for a in "xy")
    state = "parallel" if content["aligned"] else "not parallel"
    verdict = Verdict(content["aligned"], f"The glass is {state}: it leans by {tilts}", content.get("next") or "")
    # The tolerance is one of size.
    series = [
        Series(
            f"about {axis}",
            np.abs([one[f"about_{axis}_deg"] for one in rounds]),
            [one[f"sigma_about_{axis}_deg"] for one in rounds],
        )
        for axis in "xy"
    ]
    figure = curves(
        range(1, len(rounds) + 1),
        series,
        x_label="round",
        y_label="tilt of the glass (degrees)",
        limit=(tolerance, "tolerance"),
    )
    caption = "Size of the tilt in each round, with a band of one standard deviation."
    picture = Picture("tilt", figure, "Tilt of the glass about x and y in each round, beside the tolerance.", caption)
    return verdict, _sections(run, "Tilt of the glass", (picture,))


def characterise(run: Run) -> tuple[Verdict, tuple[Section, ...]]:
    """What was characterised: figures first, then its words."""
    content = run.content or {}
    verdict, blocks = _WHAT[content["what"]](content)
    return verdict, _sections(run, "What was found", (*blocks, Text(content["words"])))


def _sections(run: Run, heading: str, blocks: tuple[Block, ...]) -> tuple[Section, ...]:
    frames = Section("Frames", contact_sheet(run, run.entries, "frames", "frames") or (Text("There are no frames."),))
    used = used_section(run)
    return (Section(heading, blocks), frames, *(() if used is None else (used,)))


def _gamma(content: Content) -> _Found:
    levels, law = np.array(content["levels"]), content["gamma"]
    series = [
        Series("measured", content["light"], content["sigma_light"]),
        Series("law", (levels / max(float(levels.max()), 1.0)) ** law),
    ]
    response = curves(levels, series, x_label="level shown", y_label="light, of a white picture's")
    table = np.array(content["table"], dtype=np.float64)
    change = curves(
        np.arange(float(table.size)), [Series("table", table - np.arange(table.size))], x_label="level meant",
        y_label="level to show, less that",
    )  # fmt: skip
    headline = f"Gamma {with_sigma(law, content['sigma_gamma'])}"
    told = f"What the law leaves: {100 * content['rms']:.2f} % of full light, rms."
    return Verdict(None, headline, told), (
        Picture("gamma", response, "Light against the level shown.", "Light against the level, beside the fitted law."),
        Picture("compensation", change, "Change of each level that makes the light linear.", "Compensating table."),
    )


def _delay(content: Content) -> _Found:
    figure = curves(
        content["after_ms"], [Series("light", content["light"])], x_label="after the order (ms)",
        y_label="light, of a white picture's",
    )  # fmt: skip
    headline = f"All light is there {number(content['delay_ms'])} ms after the order"
    told = f"Not yet after {number(content['not_before_ms'])} ms."
    return Verdict(None, headline, told), (
        Picture("delay", figure, "Light after the order to show a picture.", "Light after the order."),
    )


def _settle(content: Content) -> _Found:
    still = content["still_um"]
    series = [Series("off", np.abs(content["off_um"]), [content["sigma_um"]] * len(content["off_um"]))]
    figure = curves(
        content["after_s"], series, x_label="after the motion's end (s)", y_label="beside its place (µm)",
        limit=(still, "allowed"),
    )  # fmt: skip
    settle_s = content["settle_s"]
    headline = (
        f"The stage did not come to rest within {still:g} µm"
        if settle_s is None
        else f"Within {still:g} µm from {number(settle_s)} s on"
    )
    return Verdict(settle_s is not None, headline, f"Largest movement {number(content['largest_um'])} µm."), (
        Picture("settle", figure, "How far the stage is beside its place, over time.", "Movement after a motion."),
    )


def _stage_axis(content: Content) -> _Found:
    drift = " and ".join(
        f"{with_sigma(1e3 * value, 1e3 * sigma)} µm along {axis}"
        for value, sigma, axis in zip(content["drift"], content["sigma_drift"], "xy", strict=True)
        if sigma is not None and np.isfinite(sigma)
    )
    off = np.array(content["off_line_um"], dtype=np.float64)
    series = [Series(axis, off[:, k]) for k, axis in enumerate("xyz"[: off.shape[1]])] if off.ndim == 2 else []
    series = series or [Series("off the line", off)]
    figure = curves(content["positions_mm"], series, x_label="stage 1 (mm)", y_label="off a straight line (µm)")
    headline = f"A mm away from the glass shifts the mirror by {drift}"
    told = (
        f"Scale of its motion against the calibrated geometry: {with_sigma(content['scale'], content['sigma_scale'])}."
    )
    return Verdict(None, headline, told), (
        Picture("off_line", figure, "Positions of the stage beside a straight line.", "Beside a straight line."),
    )


def _focus(content: Content) -> _Found:
    curve = curves(
        content["counts"], [Series("contrast", content["contrast"])], x_label="fringes across the projector",
        y_label="contrast, of the coarsest",
    )  # fmt: skip
    cells = np.array([[np.nan if v is None else v for v in row] for row in content["blur_cells_px"]], np.float64)
    where = maps([Panel("blur", cells)], unit="px of the projector", colours="height")
    return Verdict(None, f"Blur of {number(content['blur_px'])} projector pixels (rms)"), (
        Picture("contrast", curve, "Contrast of fringes of several widths.", "Contrast of finer and finer fringes."),
        Picture("blur", where, "Map of the blur over the picture.", "Blur over the picture, in cells."),
    )


def _exposure(content: Content) -> _Found:
    series = [Series("brightest parts", content["bright"]), Series("share of saturated pixels", content["saturated"])]
    figure = curves(content["exposures_us"], series, x_label="exposure (µs)", y_label="of full scale; of all pixels")
    best = content["recommended_us"]
    headline = "No exposure can be recommended" if best is None else f"Expose for {number(best)} µs"
    rows = (
        ("off a straight line (%)", number(None if content["nonlinearity"] is None else 100 * content["nonlinearity"])),
        ("noise without light (DN)", number(content["noise_floor_dn"])),
        ("growth of the variance with the value (DN)", number(content["shot_dn"])),
    )
    return Verdict(best is not None, headline), (
        Facts(rows),
        Picture("exposure", figure, "Brightness and saturation against the exposure.", "Against the exposure."),
    )


_WHAT: Mapping[str, Callable[[Content], _Found]] = {
    "gamma": _gamma,
    "delay": _delay,
    "settle": _settle,
    "stage-axis": _stage_axis,
    "focus": _focus,
    "exposure": _exposure,
}
