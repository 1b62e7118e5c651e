"""The paper, reproduced."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, notes, print_json, say


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for report, figures, numbers and recipes.")] = Path("reproduction"),
    size_px: Annotated[
        int, typer.Option(help="Camera pixels along a side (same view): a quick look at less resolution.")
    ] = 2048,
    seed: Annotated[int, typer.Option(help="Of the rig's misalignment and of all noise.")] = 1,
    only: Annotated[
        str,
        typer.Option(help="Parts, with commas between them: tables, figures, repeatability, sweeps; all by default."),
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="All numbers as one JSON object on standard output.")] = False,
) -> None:
    """Take the paper's tables and figures in a simulated, misaligned rig, by its method and by ours.

    Also what the paper leaves out: repeatability, and errors against misalignment, noise and fringe count. Writes one
    page that needs nothing else (report.html), its figures as SVG, numbers as JSON, tables as CSV, and the recipes.
    """
    from irpmd_rig.report.run import REPORT
    from irpmd_rig.reproduce.command import Request
    from irpmd_rig.reproduce.command import reproduce as carry_out
    from irpmd_rig.reproduce.scheme import PARTS

    parts = tuple(part.strip() for part in only.split(",")) if only else PARTS
    numbers = carry_out(Request(out, size_px, seed, parts), notes)
    if as_json:
        print_json(numbers)
    else:
        say(str(out / REPORT))
