"""The results of a run: each file is there whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import tifffile
from numpy.typing import NDArray

from irpmd_rig.store.durable import sync_folder, typed_errors, write_file
from irpmd_rig.store.errors import RunFolderError
from irpmd_rig.store.formats import write_point_cloud
from irpmd_rig.store.paths import file_within

RESULT, CALIBRATION = "result.json", "calibration.json"
"""What a run found: a calibration or reference the second, any other the first. It is written last."""

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


class Results:
    """The folder `results/` of a run. Names are plain file names; every writer raises DiskFull or WriteFailed.

    Parameters
    ----------
    folder
        The folder; it is made when something is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def names(self) -> tuple[str, ...]:
        """Names of the files that are there; links and folders that somebody put beside them are none."""
        if not self.folder.is_dir():
            return ()
        found = (path for path in self.folder.iterdir() if path.is_file() and not path.is_symlink())
        return tuple(sorted(path.name for path in found if _NAME.fullmatch(path.name)))

    def path(self, name: str) -> Path:
        """Path of a file; raises FileNotInRun if there is none of this name."""
        return file_within(self.folder, name)

    def write(self, name: str, write: Callable[[BinaryIO], object]) -> Path:
        """Write a file by a function that gets an open binary stream."""
        if not _NAME.fullmatch(name) or name.endswith(".part"):
            raise RunFolderError(f"{name!r} is no name for a result: letters, digits, '_', '-' and '.'")
        path = self.folder / name
        with typed_errors(path):
            if not self.folder.is_dir():
                self.folder.mkdir()
                sync_folder(self.folder.parent)
        write_file(path, write)
        return path

    def write_text(self, name: str, text: str) -> Path:
        """Write a text."""
        return self.write(name, lambda stream: stream.write(text.encode()))

    def write_json(self, name: str, content: Mapping[str, Any]) -> Path:
        """Write JSON that a person can read; raises ValueError if a number is not finite."""
        return self.write_text(name, json.dumps(content, indent=2, allow_nan=False) + "\n")

    def write_array(self, name: str, array: NDArray[np.generic]) -> Path:
        """Write one array as npy."""
        return self.write(name, lambda stream: np.save(stream, array, allow_pickle=False))

    def write_arrays(self, name: str, arrays: Mapping[str, NDArray[np.generic]]) -> Path:
        """Write several arrays as npz."""
        return self.write(name, lambda stream: np.savez(stream, allow_pickle=False, **arrays))

    def write_map(self, name: str, values: NDArray[np.generic], unit: str) -> Path:
        """Write a map (H, W) as TIFF, with its unit in the description."""
        return self.write(name, lambda stream: tifffile.imwrite(stream, values, metadata={"unit": unit}))

    def write_points(
        self, name: str, points_mm: NDArray[np.floating], properties: Mapping[str, NDArray[np.generic]] | None = None
    ) -> Path:
        """Write points (..., 3) in mm, and more properties of each, as binary PLY; unknown points are left out."""
        return self.write(name, lambda stream: write_point_cloud(stream, points_mm, properties or {}))

    def write_table(self, name: str, rows: Sequence[Mapping[str, object]]) -> Path:
        """Write rows as CSV; the first row's keys are the columns. Without rows the file is empty."""
        text = io.StringIO()
        if rows:
            writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        return self.write_text(name, text.getvalue())

    def read_json(self, name: str) -> dict[str, Any]:
        """Read a JSON object; raises FileNotInRun or RunFolderError."""
        path = self.path(name)
        try:
            content = json.loads(path.read_bytes())
        except ValueError as error:
            raise RunFolderError(f"{path}: not JSON: {error}") from error
        if not isinstance(content, dict):
            raise RunFolderError(f"{path}: not a JSON object")
        return content

    def read_array(self, name: str) -> NDArray[Any]:
        """Read an npy file; raises FileNotInRun or RunFolderError."""
        array: NDArray[Any] = self._loaded(name, np.ndarray)
        return array

    def read_arrays(self, name: str) -> dict[str, NDArray[Any]]:
        """Read an npz file; raises FileNotInRun or RunFolderError."""
        with self._loaded(name, np.lib.npyio.NpzFile) as file:
            return dict(file.items())

    def clear(self) -> None:
        """Delete what an earlier attempt computed."""
        for name in self.names():
            self.path(name).unlink()

    def _loaded(self, name: str, kind: type) -> Any:
        path = self.path(name)
        try:
            content = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise RunFolderError(f"{path}: not readable: {error}") from error
        if not isinstance(content, kind):
            raise RunFolderError(f"{path}: holds {type(content).__name__}, not {kind.__name__}")
        return content
