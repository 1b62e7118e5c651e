"""Files that arrive: whole at their place, or not there at all."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Self


class Arriving:
    """A file while it arrives; a context manager.

    Parameters
    ----------
    target
        Where to; a folder stands for the file's own name in it.
    path
        What it is called at its origin.
    """

    def __init__(self, target: Path, path: str) -> None:
        self.target = target / PurePosixPath(path).name if target.is_dir() else target
        self._beside = self.target.with_name(f".{self.target.name}.part")

    def __enter__(self) -> Self:
        self._file = self._beside.open("wb")
        return self

    def write(self, piece: bytes) -> None:
        """Add what came."""
        self._file.write(piece)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._file.close()
        if error is None:
            self._beside.replace(self.target)
        else:
            self._beside.unlink()
