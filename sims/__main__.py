"""The simulated world's command line: `python -m sims`."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from sims.bench import bench_render
from sims.errors import SimulationError, WorldError
from sims.process.frames_command import write_frames
from sims.process.instruments import Conditions, Dialect
from sims.process.lone_camera import serve_camera
from sims.process.serve import Options, chosen_world, serve
from sims.process.truth_file import write_truth
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


@app.command(name="serve")
def serve_world(
    world: Annotated[Path, typer.Argument(help="World file.")],
    folder: Annotated[Path, typer.Option(help="Where producer, sockets and serial ports appear; made if need be.")],
    seed: Annotated[int | None, typer.Option(help="Another seed than the world's.")] = None,
    size_px: Annotated[int | None, typer.Option(help="Columns of the camera.")] = None,
    time_scale: Annotated[float, typer.Option(min=0.01, max=1000, help="Seconds of the world a second.")] = 1.0,
    stages: Annotated[Dialect, typer.Option(help="What the controllers of the stages speak.")] = "gsc",
    replay: Annotated[bool, typer.Option("--replay", help="Give frames of a rehearsal back: for speed alone.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Script of faults.")] = None,
    until_stdin_closes: Annotated[bool, typer.Option("--until-stdin-closes", help="End with standard input.")] = False,
) -> None:
    """Serve the instruments of a world until SIGTERM."""
    conditions = Conditions(stages, time_scale, replay)
    options = Options(world, folder, seed, size_px, conditions, faults, until_stdin_closes)
    with _complaining():
        serve(options)


@app.command()
def truth(
    world: Annotated[Path, typer.Argument(help="World file.")],
    name: Annotated[str, typer.Option("--object", help="Object of the world.")],
    out: Annotated[Path, typer.Option(help="File to write (.npz).")],
    seed: Annotated[int | None, typer.Option(help="Another seed than the world's.")] = None,
    size_px: Annotated[int | None, typer.Option(help="Columns of the camera.")] = None,
) -> None:
    """Write what a measurement of an object should find: points, facets, steps, distances."""
    with _complaining():
        write_truth(chosen_world(world, seed, size_px), name, out)


@app.command()
def frames(
    world: Annotated[Path, typer.Argument(help="World file.")],
    request: Annotated[Path, typer.Argument(help="Stations, pictures and exposures (JSON).")],
    out: Annotated[Path, typer.Option(help="Folder of the frames; made if need be.")],
    seed: Annotated[int | None, typer.Option(help="Another seed than the world's.")] = None,
    size_px: Annotated[int | None, typer.Option(help="Columns of the camera.")] = None,
) -> None:
    """Render the frames of a run without instruments: a .npy a station and an index."""
    with _complaining():
        write_frames(chosen_world(world, seed, size_px), request, out)


@app.command()
def camera(
    folder: Annotated[Path, typer.Argument(help="Where the producer appears; made if need be.")],
    size_px: Annotated[int, typer.Option(min=64, max=8192, help="Rows and columns.")] = 2048,
    unpaced: Annotated[bool, typer.Option("--unpaced", help="As fast as frames are taken.")] = False,
) -> None:
    """Serve a camera alone that sees random pictures, until standard input closes: for benches."""
    with _complaining():
        serve_camera(folder, size_px, paced=not unpaced)


@contextmanager
def _complaining() -> Iterator[None]:
    try:
        yield
    except (WorldError, SimulationError) as error:
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)


def _load(path: Path) -> World:
    with _complaining():
        return load_world(path)


if __name__ == "__main__":
    app(prog_name="python -m sims")
