"""Simulated worlds: which there are, serving one, and what goes wrong in it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, say


@app.command()
def worlds() -> None:
    """List the simulated worlds that ship with the package."""
    from irpmd_rig.shipped import shipped_worlds

    for name, path in shipped_worlds().items():
        say(f"{name:12} {path}")


@app.command()
def sim(
    world: Annotated[str, typer.Argument(help="World file, or the name of a shipped world.")] = "misaligned",
    folder: Annotated[
        Path | None, typer.Option(help="Where its instruments appear; by default where rigs of this world look.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the noise; the world's own by default.")] = None,
    size_px: Annotated[int | None, typer.Option(help="Camera pixels along a side.")] = None,
    time_scale: Annotated[
        float | None, typer.Option(help="How much faster than the real clock its clock runs.")
    ] = None,
    stages: Annotated[str | None, typer.Option(help="What the stages speak: gsc, gcd-0301m, gcd-040101m.")] = None,
    replay: Annotated[bool, typer.Option("--replay", help="Frames of a rehearsal again: for measuring speed.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Script of faults to inject.")] = None,
) -> None:
    """Serve a simulated world until Ctrl-C; rigs whose file names this world use it."""
    from irpmd_rig.acquisition.simulated import default_folder, serve_command
    from irpmd_rig.programs import module_environment
    from irpmd_rig.shipped import world_file

    file = world_file(world)
    options = {"seed": seed, "size-px": size_px, "time-scale": time_scale, "stages": stages, "faults": faults}
    command = serve_command(file, folder or default_folder(file), options, replay=replay)
    os.execve(command[0], command, module_environment())  # it takes the place of this process, and so its signals


@app.command()
def fault(
    name: Annotated[str | None, typer.Argument(help="Name of the fault; none: list them.")] = None,
    arguments: Annotated[list[str] | None, typer.Argument(metavar="KEY=VALUE...", help="Its arguments.")] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Folder of the world; by default the only one that is running.")
    ] = None,
) -> None:
    """Make something go wrong in a running simulated world."""
    from irpmd_rig.acquisition.simulated import running_world

    control = running_world(folder)
    if name is None:
        answer = control.call("fault_names")
    else:
        answer = control.call("fault", **{**dict(map(_argument, arguments or [])), "name": name})
    sys.stdout.write(json.dumps({key: value for key, value in answer.items() if key != "ok"}, indent=2) + "\n")


def _argument(written: str) -> tuple[str, object]:
    key, equals, value = written.partition("=")
    if not (key.isidentifier() and equals):
        raise typer.BadParameter(f"{written!r} is not of the form key=value")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value
