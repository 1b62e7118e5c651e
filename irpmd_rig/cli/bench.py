"""How fast it is."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from importlib import import_module
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, print_json


class BenchName(StrEnum):
    """What can be measured: each is a module of `irpmd_rig.bench`."""

    acquire = "acquire"
    camera = "camera"
    decode = "decode"
    latency = "latency"
    memory = "memory"
    render = "render"
    service = "service"


@app.command()
def bench(
    name: Annotated[BenchName, typer.Argument(help="What to measure.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Measure speed, each figure beside a baseline taken in the same run."""
    from rich.console import Console
    from rich.table import Table

    rows = [asdict(row) for row in import_module(f"irpmd_rig.bench.{name}").run()]
    if as_json:
        print_json({"rows": rows})
        return
    table = Table(*rows[0], title=f"bench {name}")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console().print(table)
