"""The demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, notes, print_json


@app.command()
def demo(
    world: Annotated[str, typer.Option(help="World file, or the name of a shipped world.")] = "misaligned",
    object_name: Annotated[str, typer.Option("--object", help="Object of the world to measure.")] = "mirror_step_y",
    out: Annotated[Path, typer.Option(help="Folder for the results; made if it does not exist.")] = Path("demo"),
    seed: Annotated[int | None, typer.Option(help="Seed of noise and poses; the world's own by default.")] = None,
    size_px: Annotated[
        int | None, typer.Option(help="Camera pixels along a side (same view): a quick look at less resolution.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One JSON object on standard output instead of tables.")
    ] = False,
) -> None:
    """Calibrate a simulated rig from scratch and measure an object at two stage positions."""
    from rich.console import Console

    from irpmd_rig.demo.run import Request, run

    result = run(Request(world, object_name, out, seed, size_px), notes)
    if as_json:
        print_json(result.as_json())
    else:
        result.print(Console())
