"""Run folders without a daemon: computed again, and exported."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from irpmd_rig.cli.application import app, note, notes, print_json, say

if TYPE_CHECKING:
    from irpmd_rig.processing import ProcessedRun

THREADS = 2
Root = Annotated[
    Path | None,
    typer.Option("--root", help="Folder of the runs (storage.root); the folder's own, or data, by default."),
]


class Form(StrEnum):
    """What a run can be exported as."""

    hdf5 = "hdf5"
    ply = "ply"
    tiff = "tiff"
    png = "png"
    csv = "csv"


@app.command()
def reconstruct(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders of runs, also hand-written.")],
    calibration: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of a calibration to use, instead of what the run says; once for each kind."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Folder of the reference to use, instead of what the run says.")
    ] = None,
    root: Root = None,
    as_json: Annotated[bool, typer.Option("--json", help="A JSON object a folder on standard output.")] = False,
) -> None:
    """Compute the results of run folders again: from frames, counts, positions and calibration.

    Results go into the folder `results` of each. A folder needs run.yaml, manifest.jsonl and the frames that it names;
    see the README for writing one. Exit status 1 if one cannot be computed.
    """
    from irpmd_rig.processing import ProcessingError
    from irpmd_rig.store import StoreError

    right = True
    for folder in folders:
        try:
            done = _reconstructed(folder, calibration or [], reference, root)
        except (ProcessingError, StoreError) as error:
            right = False
            note(f"{folder}: {error}", style="red")
        else:
            _tell(folder, done, as_json=as_json)
    raise typer.Exit(0 if right else 1)


def _reconstructed(folder: Path, calibrations: list[Path], reference: Path | None, root: Path | None) -> ProcessedRun:
    from irpmd_rig.cli.given import given_runs, library_for
    from irpmd_rig.processing.process import reconstruct as compute

    library = library_for(folder, given_runs(calibrations, reference), root)
    with notes.status(f"{folder}") as status:
        return compute(folder, library, lambda progress: status.update(f"{folder}: {progress.text}"), threads=THREADS)


def _tell(folder: Path, done: ProcessedRun, *, as_json: bool) -> None:
    if as_json:
        print_json({"folder": str(folder), **asdict(done)})
        return
    made_with = ", ".join(f"{kind} {run_id}" for kind, run_id in done.uses.items())
    say(f"{folder}: {done.kind}" + (f", with {made_with}" if made_with else ""))
    for name, value in done.summary.items():
        say(f"  {name}: {_figures(value)}")
    say(f"  results: {', '.join(done.files)}")


def _figures(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_figures, value))
    return f"{value:.6g}" if isinstance(value, float) else "-" if value is None else str(value)


@app.command()
def export(
    run: Annotated[str, typer.Argument(help="Folder of a run, or its id below the folder of the runs.")],
    form: Annotated[Form, typer.Option("--form", help="Frames and results, points, depth map, picture, step table.")],
    out: Annotated[Path | None, typer.Option(help="File to write; named after the run by default.")] = None,
    root: Root = None,
) -> None:
    """Write a run as one file for other programs: hdf5 (NeXus), ply, tiff, png or csv."""
    from irpmd_rig.store import RunFolder, RunNotFound
    from irpmd_rig.store.export import SUFFIXES, export_run

    folder = Path(run)
    if not folder.is_dir():
        folder = (root or Path("data")) / run
    if not (folder / "run.yaml").is_file():
        raise RunNotFound(f"there is no run {run!r}: give its folder, or its id and --root")
    target = out or Path(f"{folder.resolve().name}{SUFFIXES[form]}")
    with RunFolder(folder.resolve()) as opened:
        say(str(export_run(opened, form, target)))
