"""Exports of a run: one file that other programs read."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from io import BufferedRandom
from pathlib import Path
from types import MappingProxyType

from irpmd_rig.store.durable import free_bytes, write_file
from irpmd_rig.store.errors import DiskFull, ExportError, FileNotInRun
from irpmd_rig.store.formats import coloured_picture, encode_png
from irpmd_rig.store.nexus import write_nexus
from irpmd_rig.store.run_folder import RunFolder

DEPTH, DEPTH_TIFF, POINTS, STEPS = "depth_mm.npy", "depth_mm.tif", "points.ply", "steps.csv"

_Writer = Callable[[BufferedRandom, RunFolder], object]


def _copied(name: str) -> _Writer:
    def write(stream: BufferedRandom, folder: RunFolder) -> None:
        with folder.results.path(name).open("rb") as source:
            shutil.copyfileobj(source, stream)

    return write


def _write_depth_picture(stream: BufferedRandom, folder: RunFolder) -> None:
    stream.write(encode_png(coloured_picture(folder.results.read_array(DEPTH))))


EXPORTS: MappingProxyType[str, _Writer] = MappingProxyType(
    {
        "hdf5": write_nexus,
        "ply": _copied(POINTS),
        "tiff": _copied(DEPTH_TIFF),
        "png": _write_depth_picture,
        "csv": _copied(STEPS),
    }
)
"""By format: hdf5 (NeXus: frames and results), ply (points), tiff and png (depth), csv (step table)."""

SUFFIXES = MappingProxyType({"hdf5": ".nxs.h5", "ply": ".ply", "tiff": ".tif", "png": ".png", "csv": ".csv"})


def export_run(folder: RunFolder, form: str, target: Path) -> Path:
    """Write a run in another format; the file is there whole and durable, or not at all.

    Parameters
    ----------
    folder
        The run.
    form
        One of `EXPORTS`.
    target
        The file; its folder must be there.

    Raises
    ------
    ExportError
        If the format is not known, or the run does not hold what it shows.
    RunFolderError
        If the run cannot be read.
    DiskFull, WriteFailed
        If it could not be written.
    """
    if form not in EXPORTS:
        raise ExportError(f"no export {form!r}; there are {', '.join(EXPORTS)}")
    if not target.parent.is_dir():
        raise ExportError(f"there is no folder {target.parent}")
    if target.exists() and not target.is_file():
        raise ExportError(f"{target} is no file: name one in a folder of yours")
    if form == "hdf5":
        _check_space(folder, target)
    try:
        write_file(target, lambda stream: EXPORTS[form](stream, folder))
    except FileNotInRun as error:
        raise ExportError(f"run {folder.id} has no {form} to export ({error}); reconstruct it first") from error
    return target


def _check_space(folder: RunFolder, target: Path) -> None:
    files = [folder.frame_file(entry) for entry in folder.manifest()]
    files += [folder.results.path(name) for name in folder.results.names()]
    needed, free = sum(path.stat().st_size for path in files), free_bytes(target.parent)
    if free < needed:
        raise DiskFull(target, needed, free)
