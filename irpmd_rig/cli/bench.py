"""How fast it is, and how accurate."""

from __future__ import annotations

import inspect
from dataclasses import asdict
from enum import StrEnum
from importlib import import_module
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, print_json


class BenchName(StrEnum):
    """What can be measured: each is a module of `irpmd_rig.bench`."""

    accuracy = "accuracy"
    acquire = "acquire"
    camera = "camera"
    decode = "decode"
    depth = "depth"
    latency = "latency"
    memory = "memory"
    render = "render"
    service = "service"


@app.command()
def bench(
    name: Annotated[BenchName, typer.Argument(help="What to measure.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
    seeds: Annotated[int | None, typer.Option(min=1, help="Of accuracy: worlds that are drawn.")] = None,
    size_px: Annotated[int | None, typer.Option(min=256, max=8192, help="Side of the frames.")] = None,
    cases: Annotated[str | None, typer.Option(help="Of accuracy: which, with commas between them.")] = None,
    sweep: Annotated[str | None, typer.Option(help="Of accuracy: stage-tilt, in place of the cases.")] = None,
) -> None:
    """Measure speed, each figure beside a baseline taken in the same run; or accuracy, beside the truth."""
    from rich.console import Console
    from rich.table import Table

    run = import_module(f"irpmd_rig.bench.{name}").run
    chosen = {"seeds": seeds, "size_px": size_px, "cases": cases and tuple(cases.split(",")), "sweep": sweep}
    given = {option: value for option, value in chosen.items() if value is not None}
    strange = given.keys() - inspect.signature(run).parameters.keys()
    if strange:
        raise typer.BadParameter(f"bench {name} has no option {', '.join(sorted(strange))}")
    rows = [asdict(row) for row in run(**given)]
    if as_json:
        print_json({"rows": rows})
        return
    table = Table(*rows[0], title=f"bench {name}")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console().print(table)
