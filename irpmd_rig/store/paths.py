"""Paths that come from a client or from a hand-written file: they stay in their folder."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from irpmd_rig.store.errors import FileNotInRun


def file_within(folder: Path, name: str) -> Path:
    """Path of an existing file of a folder.

    Parameters
    ----------
    folder
        The folder that it must lie in.
    name
        Relative, with forward slashes.

    Raises
    ------
    FileNotInRun
        If it is absolute, leaves the folder, goes through a symbolic link, or is no file.
    """
    relative = PurePosixPath(name)
    root = folder.resolve()
    path = root / relative
    inside = not relative.is_absolute() and ".." not in relative.parts and "\0" not in name
    try:
        # What resolves to itself goes through no symbolic link.
        if inside and path.is_relative_to(root) and path.resolve() == path and path.is_file():
            return path
    except OSError:
        pass  # e.g. a name that is too long: no such file
    raise FileNotInRun(f"{name!r} is not a file of {folder.name}")
