"""Tables 1 to 3 of the paper beside what was found here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from irpmd_rig.demo.paper import TABLE_2, TABLE_3, PaperTable
from irpmd_rig.report.content import Block, Picture, Section, Table, Text
from irpmd_rig.report.figures_graphs import Series, step_deviations
from irpmd_rig.report.wording import MISSING, fixed, micrometres, signed, with_sigma
from irpmd_rig.reproduce.printed import PIXEL_ERROR_PX, TABLE_1, TABLE_3_VISIBLE, misprints
from irpmd_rig.reproduce.results import DEPTH_EQUATION, OURS, Results, steps_of
from irpmd_rig.reproduce.scheme import FAN, STEP
from irpmd_rig.reproduce.taken import PLAIN, Steps, Taken

_LENS = (("focal_px", 0), ("focal_px", 1), ("principal_point_px", 0), ("principal_point_px", 1),
         ("distortion", 0), ("distortion", 1), ("distortion", 2), ("distortion", 3))  # fmt: skip


_UNBIASED = "unbiased planes"
"""Another evaluation of the paper's depths: in tables, not in pictures."""


@dataclass(frozen=True, slots=True)
class Column:
    """Steps of one measurement by one method.

    Attributes
    ----------
    name
        Of the way in which they were measured.
    run_id
        Where they come from; empty for the paper.
    steps
        The steps.
    """

    name: str
    run_id: str
    steps: Steps

    def content(self) -> dict[str, Any]:
        """Everything as JSON."""
        steps = self.steps
        return {
            "way": self.name,
            "run": self.run_id or None,
            "measured_mm": list(steps.measured_mm),
            "error_um": list(steps.errors_um),
            "sigma_um": [value if np.isfinite(value) else None for value in steps.sigmas_um],
            "largest_error_um": steps.largest_um if steps.errors_um else None,
        }


@dataclass(frozen=True, slots=True)
class StepTable:
    """One of the paper's tables of steps, and the ways in which it was measured.

    Attributes
    ----------
    name
        In file names and in JSON.
    paper
        As printed.
    light
        With which it was measured.
    columns
        The paper's first.
    """

    name: str
    paper: PaperTable
    light: str
    columns: tuple[Column, ...]

    def content(self) -> dict[str, Any]:
        """Everything as JSON."""
        return {
            "table": self.paper.name,
            "light": self.light,
            "actual_mm": list(self.paper.actual_mm),
            "misprinted_rows": [f"{k + 1}-{k + 2}" for k in misprints(self.paper)],
            "ways": [column.content() for column in self.columns],
        }


def step_tables(results: Results) -> tuple[StepTable, ...]:
    """Table 2, and Table 3 with either light: the paper's figures, its method here, and ours."""
    asked = (
        ("table_2", TABLE_2, "infrared", results.of("paper", STEP), results.of("precise", STEP)),
        ("table_3_infrared", TABLE_3, "infrared", results.of("paper", FAN), results.of("precise", FAN)),
        ("table_3_visible", TABLE_3_VISIBLE, "visible", results.of("visible", FAN), results.of("precise-visible", FAN)),
    )
    return tuple(
        StepTable(name, paper, light, (_printed(paper), *_columns(taken, precise)))
        for name, paper, light, taken, precise in asked
        if taken is not None
    )


def _printed(paper: PaperTable) -> Column:
    unknown = (np.nan,) * len(paper.actual_mm)
    errors = tuple(paper.error_um(k) for k in range(len(paper.actual_mm)))
    return Column("the paper", "", Steps(paper.measured_mm, errors, unknown, unknown))


def _columns(taken: Taken, precise: Taken | None) -> tuple[Column, ...]:
    asked = (
        ("its method here", taken, PLAIN),
        (_UNBIASED, taken, DEPTH_EQUATION),
        ("ours", taken, OURS),
        ("ours, precise", precise, OURS),
    )
    return tuple(Column(name, t.run_id, steps_of(t, method)) for name, t, method in asked if t is not None)


def step_sections(tables: Sequence[StepTable]) -> tuple[Section, ...]:
    """A section for Table 2, one for Table 3 with both lights."""
    sections = []
    for heading, paper in (("Table 2: mirror step", (TABLE_2,)), ("Table 3: fan", (TABLE_3, TABLE_3_VISIBLE))):
        found = [table for table in tables if table.paper in paper]
        blocks = [block for table in found for block in _table_blocks(table)]
        if len(found) > 1:
            blocks += [lights_table(found), Text(_LIGHTS)]
        sections += [Section(heading, (Text(_WAYS), *blocks))] if blocks else []
    return tuple(sections)


_WAYS = (
    "The paper: as printed. Its method here: its recipe (four steps, positions 0 and 40 mm, filtered phases), its "
    "depth equation, and least-squares planes of z over x and y. Unbiased planes: the same depths, planes fitted "
    "without the bias that noise gives those. Ours: the same frames, facet by facet with the rig model. Ours, precise: "
    "eight steps, positions -60 and 40 mm."
)

_LIGHTS = (
    "What differs between the lights is the world's alone: ambient light that the camera's filter keeps out in "
    "infrared and lets through in visible light, its flicker, its shot noise, and the shorter exposure that then does "
    "not saturate. Reference and object are both taken in the light named; the calibration of the geometry is one, as "
    "in the paper."
)


def _table_blocks(table: StepTable) -> tuple[Block, ...]:
    names = [f"{k + 1}-{k + 2}" for k in range(len(table.paper.actual_mm))]
    series = [
        Series(column.name, column.steps.errors_um, _known(column.steps.sigmas_um))
        for column in table.columns
        if column.steps.errors_um and column.name != _UNBIASED
    ]
    caption = (
        f"{table.paper.name}: measured minus actual, in {table.light} light; bars of one and (thin) two stated sigmas."
    )
    picture = step_deviations(names, series, beside="actual")
    runs = "; ".join(f"{column.name}: {column.run_id}" for column in table.columns if column.run_id)
    shown = Picture(table.name, figure=picture, alt=caption, caption=caption)
    return *display(table), Text(f"Runs. {runs[:1].upper()}{runs[1:]}."), shown


def _known(sigmas_um: Sequence[float]) -> Sequence[float] | None:
    return sigmas_um if np.isfinite(sigmas_um).any() else None


def display(table: StepTable) -> tuple[Table, Table]:
    """Errors, with largest and rms, and the steps as they were measured."""
    names = [f"{k + 1}-{k + 2}" for k in range(len(table.paper.actual_mm))]
    ways = [column.name for column in table.columns]
    errors = [(name, *(_error(c.steps, k) for c in table.columns)) for k, name in enumerate(names)]
    errors += [
        ("largest", *(micrometres(c.steps.largest_um) for c in table.columns)),
        ("rms", *(micrometres(c.steps.rms_um) for c in table.columns)),
    ]
    measured = [
        (name, fixed(actual_mm, 5), *(_measured(c.steps, k) for c in table.columns))
        for k, (name, actual_mm) in enumerate(zip(names, table.paper.actual_mm, strict=True))
    ]
    told = "".join(
        f" Row {k + 1}-{k + 2}: the printed error is not measured minus actual, which is given."
        for k in misprints(table.paper)
    )
    title = f"{table.paper.name}, {table.light} light"
    return (
        Table(("step", *(f"{way} (µm)" for way in ways)), tuple(errors), f"{title}: measured minus actual.{told}"),
        Table(("step", "actual (mm)", *(f"{way} (mm)" for way in ways)), tuple(measured), f"{title}: steps"),
    )


def _error(steps: Steps, k: int) -> str:
    if not steps.errors_um:
        return MISSING
    return signed(steps.errors_um[k], 1 if abs(steps.errors_um[k]) >= 10 else 2)


def _measured(steps: Steps, k: int) -> str:
    if not steps.errors_um:
        return MISSING
    sigma = steps.sigmas_um[k]
    return with_sigma(steps.measured_mm[k], sigma / 1e3) if np.isfinite(sigma) else fixed(steps.measured_mm[k], 5)


def lights_table(tables: Sequence[StepTable]) -> Table:
    """Errors in infrared beside those in visible light."""
    rows = []
    for columns in zip(*(table.columns for table in tables), strict=True):
        cells = [micrometres(c.steps.largest_um) for c in columns] + [micrometres(c.steps.rms_um) for c in columns]
        rows.append((columns[0].name, *cells))
    heads = [f"{figure}, {table.light} (µm)" for figure in ("largest error", "rms error") for table in tables]
    return Table(("way", *heads), tuple(rows), "Infrared beside visible light")


def lens_content(results: Results) -> list[dict[str, Any]]:
    """Table 1 as JSON: what is printed, what is true in the world, and what was found."""
    run_id, content = results.calibrations["camera"]
    lens, camera = content["intrinsics"], results.world["camera"]
    scale = results.size_px / camera["size_px"][0]
    true = [
        *(f * scale for f in camera["fc_px"]),
        *((c + 0.5) * scale - 0.5 for c in camera["cc_px"]),
        *camera["kc"][:4],
    ]
    return [
        {
            "name": line.name,
            "paper": line.value,
            "paper_uncertainty": line.uncertainty,
            "true": float(truth),
            "found": float(lens[key][k]),
            "sigma": float(lens[f"sigma_{key}"][k]),
            "run": run_id,
        }
        for line, truth, (key, k) in zip(TABLE_1, true, _LENS, strict=True)
    ]


def lens_section(results: Results) -> tuple[Section, Table]:
    """Table 1 as a section, and its table."""
    run_id, content = results.calibrations["camera"]
    rows = [
        (
            line["name"],
            f"{line['paper']:.5f} ± {line['paper_uncertainty']:.5f}",
            fixed(line["true"], 5),
            with_sigma(line["found"], line["sigma"]),
            signed((line["found"] - line["true"]) / line["sigma"], 1),
        )
        for line in lens_content(results)
    ]
    table = Table(
        ("", "the paper", "truth of the world", "found here", "off by (sigmas)"),
        tuple(rows),
        f"Table 1: the camera, from {len(content['boards'])} of 30 rendered poses of the checkerboard; run {run_id}",
    )
    shrunk = (
        ""
        if results.size_px == 2048
        else f" Focal length and principal point are of {results.size_px} columns, the paper's of 2048."
    )
    pixel_error = ", ".join(f"{value:.4f}" for value in content["intrinsics"]["pixel_error_px"])
    blocks: tuple[Block, ...] = (
        table,
        Text(
            f"± is one standard deviation here; the toolbox that the paper used prints about three. Pixel error: "
            f"{pixel_error} px, the paper {PIXEL_ERROR_PX[0]}, {PIXEL_ERROR_PX[1]}. The world's camera is Table 1's."
            f"{shrunk}"
        ),
        *_distance(results),
    )
    return Section("Table 1: camera", blocks), table


def _distance(results: Results) -> tuple[Block, ...]:
    run_id, geometry = results.calibrations["geometry"]
    model, true_mm = geometry.get("rig_model"), results.truth.d_mm
    rows = [
        ("the paper's planes, at the middle of the glass", geometry["d_mm"], geometry["sigma_d_mm"]),
        ("the paper's mean over the seen glass", geometry["d_seen_mean_mm"], None),
    ]
    rows += [("rig model", model["d_mm"], model.get("sigma_d_mm"))] if model else []
    cells = tuple((name, with_sigma(d, sigma), signed(1e3 * (d - true_mm), 1)) for name, d, sigma in rows)
    caption = f"Distance d from reference to glass; truth {true_mm:.4f} mm; run {run_id}"
    return (Table(("by", "d (mm)", "error (µm)"), cells, caption),)
