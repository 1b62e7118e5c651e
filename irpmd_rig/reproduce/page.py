"""The page of a reproduction, its numbers as JSON, and its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from irpmd_rig.report.content import Block, Facts, Files, Page, Section, Table, Text, Verdict
from irpmd_rig.report.wording import micrometres
from irpmd_rig.reproduce.beyond import (
    SWEEPS,
    repeatability_content,
    repeatability_section,
    sweep_content,
    sweep_section,
)
from irpmd_rig.reproduce.figures import figure_sections
from irpmd_rig.reproduce.printed import errata
from irpmd_rig.reproduce.results import DEPTH_EQUATION, OURS, Results
from irpmd_rig.reproduce.scheme import FREEFORM
from irpmd_rig.reproduce.tables import StepTable, lens_content, lens_section, step_sections, step_tables
from irpmd_rig.store.record import software_versions


def numbers(results: Results, parts: Sequence[str]) -> dict[str, Any]:
    """Everything that was found, each number with its run."""
    content: dict[str, Any] = {
        "seed": results.seed,
        "size_px": results.size_px,
        "parts": list(parts),
        "seconds": round(results.seconds, 1),
        "versions": software_versions(),
    }
    if "tables" in parts:
        content["table_1"] = lens_content(results)
        content |= {table.name: table.content() for table in step_tables(results)}
    if "figures" in parts:
        content["freeform"] = [
            {"recipe": use, "method": method, "run": taken.run_id, **asdict(taken.compared[method])}
            for use in ("paper", "precise")
            if (taken := results.of(use, FREEFORM)) is not None
            for method in (DEPTH_EQUATION, OURS)
            if method in taken.compared
        ]
    if "repeatability" in parts:
        content["repeatability"] = repeatability_content(results)
    if "sweeps" in parts:
        content["sweeps"] = {sweep.use: sweep_content(results, sweep) for sweep in SWEEPS}
    content["errata"] = list(errata())
    content["runs"] = [
        {
            "run": entry.run_id,
            "recipe": entry.recipe_file,
            "world": entry.task.world.name,
            "use": entry.task.use,
            "object": entry.task.subject or None,
            "at": entry.task.at,
        }
        for entry in results.runs
    ]
    return {name: _finite(value) for name, value in content.items()}


def _finite(value: Any) -> Any:
    """JSON has no NaN: what is not known is null."""
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not abs(value) < float("inf") else value


def page(results: Results, parts: Sequence[str], reports: Sequence[str]) -> tuple[Page, dict[str, Table]]:
    """Page of a reproduction, and its tables by name.

    Parameters
    ----------
    results, parts
        What was found, and what was wanted.
    reports
        Reports of single runs, beside the page.
    """
    sections: list[Section] = []
    tables: dict[str, Table] = {}
    found = step_tables(results) if "tables" in parts else ()
    if "tables" in parts:
        section, tables["table_1"] = lens_section(results)
        sections += [section, *step_sections(found)]
    if "figures" in parts:
        sections += figure_sections(results)
    beyond = [("repeatability", repeatability_section(results))]
    beyond += [(sweep.use.replace("-", "_"), sweep_section(results, sweep)) for sweep in SWEEPS]
    for name, one in beyond:
        if one is not None:
            sections.append(one[0])
            tables[name] = one[1]
    sections += [_errata(), _origin(results, reports)]
    head = Page("The paper, reproduced", _subtitle(results), _verdict(found), tuple(sections))
    return head, tables


def _subtitle(results: Results) -> str:
    return (
        f"simulated rig, misaligned, seed {results.seed} · {results.size_px} columns · {len(results.runs)} runs · "
        f"{results.seconds / 60:.1f} minutes"
    )


def _verdict(tables: Sequence[StepTable]) -> Verdict:
    if not tables:
        return Verdict(None, "The paper's tables were not asked for")
    told = "; ".join(
        f"{table.name.replace('_', ' ')}: "
        + ", ".join(f"{column.name} {micrometres(column.steps.largest_um)}" for column in table.columns)
        for table in tables
    )
    by_way = {column.name: column.steps.largest_um for column in tables[0].columns}
    ours = by_way.get("ours, precise", float("nan"))
    headline = (
        f"Mirror step, largest error: {micrometres(by_way['the paper'])} µm in the paper, "
        f"{micrometres(by_way['its method here'])} by its method here, {micrometres(ours)} by ours"
    )
    return Verdict(None, headline, f"Largest step errors, µm. {told[:1].upper()}{told[1:]}.")


def _errata() -> Section:
    return Section("The paper's errata", tuple(Text(text) for text in errata()))


def _origin(results: Results, reports: Sequence[str]) -> Section:
    world = results.world
    facts = (
        ("world", "misaligned, its axes and signs drawn from the seed: worlds/world.yaml; not told to the estimator"),
        ("glass tilted by (°)", f"{world['glass']['tilt_about_x_deg']:.4f}, {world['glass']['tilt_about_y_deg']:.4f}"),
        (
            "stage's axis tilted by (°)",
            f"{world['stage1']['axis_tilt_about_x_deg']:.4f}, {world['stage1']['axis_tilt_about_y_deg']:.4f}",
        ),
        (
            "projector tilted by (°)",
            f"{world['projector']['tilt_about_x_deg']:.4f}, {world['projector']['tilt_about_y_deg']:.4f}",
        ),
        ("versions", ", ".join(f"{name} {version}" for name, version in software_versions().items())),
    )
    rows = tuple(
        (entry.run_id, entry.recipe_file, entry.task.world.name, entry.task.use, f"{entry.task.at:g}")
        for entry in results.runs
    )
    blocks: list[Block] = [
        Facts(facts),
        Text(
            "The recipes lie beside this page; a lab carries out the same ones with `irpmd-rig run`, in the order of "
            "their numbers. Every number above comes from the run that is named with it:"
        ),
        Table(("run", "recipe", "world", "for", "at"), rows, "All runs in their order"),
    ]
    if reports:
        blocks += [Text("Reports of single runs:"), Files(tuple(reports))]
    return Section("Runs and recipes", tuple(blocks), folded=True)
