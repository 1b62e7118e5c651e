"""The simulated world's command line: `python -m sims`."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from sims.bench import bench_render
from sims.errors import WorldError
from sims.world import World, load_world

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
# Beside the packages in a checkout, inside one of them once installed.
_ABOVE = Path(__file__).parent.parent
_WORLDS = next(
    (folder for place in (".", "irpmd_rig") if (folder := _ABOVE / place / "configs" / "worlds").is_dir()), _ABOVE
)
_MISALIGNED = _WORLDS / "misaligned.yaml"


@app.callback()
def _sims() -> None:
    """Run or check the simulated world."""


@app.command()
def check(world: Annotated[Path, typer.Argument(help="World file.")]) -> None:
    """Load and validate a world file; every error is reported with its line and column."""
    loaded = _load(world)
    typer.echo(f"{world}: valid; {len(loaded.objects)} objects: {', '.join(loaded.objects)}")


@app.command()
def render_bench(
    world: Annotated[Path, typer.Option(help="World file.")] = _MISALIGNED,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
    runs: Annotated[int, typer.Option(min=3, max=1000, help="Frames that the median is taken of.")] = 25,
) -> None:
    """Time the rendering of noisy frames beside plain numpy."""
    rows = bench_render(_load(world), runs=runs)
    if as_json:
        typer.echo(json.dumps({"rows": rows}))
        return
    for row in rows:
        typer.echo(
            f"{row['name']}: {row['value']} {row['unit']} (must {row['must']}, aim {row['aim']}); "
            f"{row['baseline']}: {row['baseline_value']} {row['unit']}, {row['ratio']} times as long"
        )


def _load(path: Path) -> World:
    try:
        return load_world(path)
    except WorldError as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    app(prog_name="python -m sims")
