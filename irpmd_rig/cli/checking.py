"""Files checked before anything is run: rig files, recipes, worlds."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from irpmd_rig.cli.application import app, note, say
from irpmd_rig.programs import module_command, module_environment

if TYPE_CHECKING:
    from collections.abc import Iterable

    from irpmd_rig.recipes.equipment import Equipment

# Keys that only one kind of file has.
_OF_WORLDS = ("glass", "lights", "lamp", "objects", "mirror", "plate", "board")
_OF_RIGS = ("camera", "projector", "stage1", "stage2", "storage", "service")
WORLD_LIMIT_S = 120.0


class _Wrong(Exception):
    """A file that is wrong; a line for everything that is."""

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(lines)
        super().__init__(*self.lines)


@app.command()
def validate(
    files: Annotated[list[str], typer.Argument(metavar="FILE...", help="Files, or names of shipped ones.")],
    rig: Annotated[
        str | None, typer.Option("--rig", help="Rig whose limits the recipes have to keep, as far as its file tells.")
    ] = None,
) -> None:
    """Check rig files, recipes and worlds without touching a rig.

    Every mistake is told with file, line and column. Exit status 0 if all files are right, 1 if one is not, 2 if one
    is not there.
    """
    paths = [_found(name) for name in files]
    right = True
    for path in paths:
        try:
            say(f"{path}: {_checked(path, rig)}")
        except _Wrong as wrong:
            right = False
            for line in wrong.lines:
                note(line)
    raise typer.Exit(0 if right else 1)


def _found(name: str) -> Path:
    """Find a file by its path, or a shipped one by its name.

    Raises
    ------
    FileNotFoundError
        There is neither.
    """
    from irpmd_rig.shipped import shipped_recipes, shipped_rigs, shipped_worlds

    if Path(name).exists():
        return Path(name)
    shipped = {**shipped_worlds(), **shipped_recipes(), **shipped_rigs()}
    known = shipped.get(name.removesuffix(".yaml"))
    if known is None:
        raise FileNotFoundError(f"there is no file {name!r}: give a path or one of {', '.join(shipped)}")
    return known


def _checked(path: Path, rig: str | None) -> str:
    """Check a file as what its keys show it to be; says what it is, or raises _Wrong."""
    from irpmd_rig.recipes.document import DocumentError, parse_document

    try:
        keys = parse_document(path).values
        if any(key in keys for key in _OF_WORLDS):
            return _checked_world(path)
        if "kind" not in keys and any(key in keys for key in _OF_RIGS):
            return _checked_rig(path)
        return _checked_recipe(path, rig)
    except DocumentError as error:
        raise _Wrong(str(problem) for problem in error.problems) from None


def _checked_rig(path: Path) -> str:
    from irpmd_rig.acquisition.rig_file import read_rig

    rig_file = read_rig(path)
    simulated = f"; simulated: {rig_file.world}" if rig_file.world else ""
    return f"rig file, right: {', '.join(rig_file.devices)}{simulated}"


def _checked_recipe(path: Path, rig: str | None) -> str:
    from irpmd_rig.recipes.document import DocumentError
    from irpmd_rig.recipes.equipment import Equipment
    from irpmd_rig.recipes.plan import check, estimate, plan
    from irpmd_rig.recipes.reading import read_recipe

    recipe, document = read_recipe(path)
    equipment = Equipment() if rig is None else _equipment(rig)
    laid_out = plan(recipe)
    problems = () if rig is None else check(recipe, laid_out, equipment, document)
    if problems:
        raise DocumentError(problems)
    takes = estimate(recipe, laid_out, equipment)
    motion = ", ".join(f"{name} {way_mm:g} mm" for name, way_mm in takes.motion_mm.items())
    return (
        f"recipe, right: {recipe.kind}; {len(laid_out.stations)} stations, {takes.frames} frames, "
        f"{takes.bytes / 1e6:.0f} MB, about {takes.seconds:.0f} s; {motion or 'no motion'}; {takes.prompts} prompts"
    )


def _equipment(rig: str) -> Equipment:
    from irpmd_rig.acquisition.interlocks import equipment_of
    from irpmd_rig.acquisition.rig import Rig
    from irpmd_rig.acquisition.rig_file import read_rig

    return equipment_of(Rig(read_rig(rig)))


def _checked_world(path: Path) -> str:
    """Let the simulator check its own file: it is a program apart."""
    command = module_command("sims", "check", str(path))
    ended = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=WORLD_LIMIT_S,
        check=False,
        env=module_environment(),
    )
    if ended.returncode == 0:
        return "world, right: " + ended.stdout.strip().rpartition(": valid; ")[2]
    raise _Wrong(ended.stderr.strip().removeprefix("error: ").splitlines())
