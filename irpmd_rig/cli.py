"""The command line."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.table import Table

from irpmd_rig.bench.timing import Row
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.shipped import shipped_worlds

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Infrared phase-measuring deflectometry: the 3-D shape of mirror-like, also discontinuous, objects.",
)
_notes = Console(stderr=True)


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
    from irpmd_rig.demo.run import Request, run

    result = run(Request(world, object_name, out, seed, size_px), _notes)
    if as_json:
        sys.stdout.write(json.dumps(result.as_json()) + "\n")
    else:
        result.print(Console())


class BenchName(StrEnum):
    """What can be measured."""

    camera = "camera"
    decode = "decode"
    render = "render"


@app.command()
def bench(
    name: Annotated[BenchName, typer.Argument(help="What to measure.")],
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Measure speed, each figure beside a baseline taken in the same run."""
    rows = [asdict(row) for row in _BENCHES[name]()]
    if as_json:
        sys.stdout.write(json.dumps({"rows": rows}) + "\n")
        return
    table = Table(*rows[0], title=f"bench {name}")
    for row in rows:
        table.add_row(*(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console().print(table)


def _bench_camera() -> list[Row]:
    from irpmd_rig.bench import camera

    return camera.run()


def _bench_decode() -> list[Row]:
    from irpmd_rig.bench import decode

    return decode.run()


def _bench_render() -> list[Row]:
    from irpmd_rig.bench import render

    return render.run()


_BENCHES = {BenchName.camera: _bench_camera, BenchName.decode: _bench_decode, BenchName.render: _bench_render}


@app.command()
def worlds() -> None:
    """List the simulated worlds that ship with the package."""
    for name, path in shipped_worlds().items():
        Console(soft_wrap=True).print(f"{name:12} {path}", highlight=False)


def main() -> None:
    """Run the command line; bad input ends in one line and exit status 2."""
    logging.basicConfig(
        level=logging.WARNING,
        format="%(message)s",
        handlers=[RichHandler(console=_notes, show_time=False, show_level=False, show_path=False)],
    )
    try:
        app()
    except (MeasurementError, OSError) as error:
        _notes.print(f"error: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(2)
