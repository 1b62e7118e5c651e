"""Writing that survives a killed process, a power cut and a full disk.

A file is written beside its place, synced and renamed, and its folder is synced: it is there whole or not at all. A
journal is appended a line at a time and synced; a last line that was torn is no line.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from io import BufferedRandom, RawIOBase
from pathlib import Path
from typing import Any

from irpmd_rig.store.errors import DiskFull, RunFolderError, WriteFailed

PART = ".part"
# EFBIG: the largest file that the file system or the process's limit allows; no room either way.
_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


def free_bytes(path: Path) -> int:
    """Bytes that may be written on the file system of an existing path."""
    return shutil.disk_usage(path).free


@contextmanager
def typed_errors(path: Path) -> Iterator[None]:
    """Turn what the operating system says about writing at ``path`` into DiskFull or WriteFailed."""
    try:
        yield
    except OSError as error:
        if error.errno in _NO_ROOM:
            raise DiskFull(path, None, free_bytes(path.parent)) from error
        raise WriteFailed(f"cannot write {path}: {error}; check the disk and its permissions") from error


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def place_file(path: Path, write: Callable[[BufferedRandom], object]) -> None:
    """Write a file beside its place, sync it and rename it; its folder is not synced yet.

    Parameters
    ----------
    path
        Its place; what was there is replaced.
    write
        Writes the content to the stream that it gets, which can also be read.

    Raises
    ------
    DiskFull, WriteFailed
        Nothing of it is left then, and what was there before is untouched.
    """
    beside = path.with_name(path.name + PART)
    with typed_errors(path):
        try:
            with beside.open("w+b") as stream:
                try:
                    write(stream)
                except OSError as error:
                    _tell_why(stream, error)
                    raise
                stream.flush()
                os.fsync(stream.fileno())
            beside.replace(path)
        except BaseException:
            with suppress(OSError):
                beside.unlink(missing_ok=True)
            raise


def write_file(path: Path, write: Callable[[BufferedRandom], object]) -> None:
    """Write a file durably, whole or not at all: `place_file`, then its folder is synced."""
    place_file(path, write)
    with typed_errors(path):
        sync_folder(path.parent)


def write_text(path: Path, text: str) -> None:
    """Write a text file durably, whole or not at all."""
    write_file(path, lambda stream: stream.write(text.encode()))


class Journal:
    """A file of JSON objects, one a line, that is only ever appended to.

    Parameters
    ----------
    path
        The file; it is made by the first `append`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._whole = False  # whether the last line is known to be whole

    def read(self) -> list[tuple[int, dict[str, Any]]]:
        """Every whole line with its number from 1; a torn last line is left out.

        Raises
        ------
        RunFolderError
            If a line before the last is no JSON object.
        """
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return []
        whole, tail = _split(content)
        lines = whole.split(b"\n")[:-1] + ([tail] if _parsed(tail) is not None else [])
        return [(number, self._object(number, line)) for number, line in enumerate(lines, 1) if line.strip()]

    def append(self, lines: Sequence[str]) -> None:
        """Append lines and sync; a torn line of an earlier process is taken away first.

        Raises
        ------
        DiskFull, WriteFailed
            None of the lines is in the file then.
        """
        new = not self.path.exists()
        with typed_errors(self.path), self.path.open("ab", buffering=0) as stream:
            self._mend()
            end = os.fstat(stream.fileno()).st_size
            try:
                _write_whole(stream, "".join(line + "\n" for line in lines).encode())
                os.fsync(stream.fileno())
            except OSError:
                os.truncate(self.path, end)
                raise
            if new:
                sync_folder(self.path.parent)

    def mend(self) -> bool:
        """Let the file end with a whole line; returns whether a torn one was taken away."""
        if not self.path.exists():
            return False
        with typed_errors(self.path):
            return self._mend()

    def _mend(self) -> bool:
        if self._whole:
            return False
        whole, tail = _split(self.path.read_bytes())
        torn = bool(tail) and _parsed(tail) is None
        with self.path.open("r+b", buffering=0) as stream:
            if torn:
                stream.truncate(len(whole))
            elif tail:
                stream.seek(0, os.SEEK_END)
                _write_whole(stream, b"\n")
            os.fsync(stream.fileno())
        self._whole = True
        return torn

    def _object(self, number: int, line: bytes) -> dict[str, Any]:
        content = _parsed(line)
        if content is None:
            raise RunFolderError(f"{self.path}:{number}: not a JSON object; mend or remove this line")
        return content


def _tell_why(stream: BufferedRandom, error: OSError) -> None:
    """Raise the system's error where numpy only said how much it wrote: writing on meets it again."""
    if error.errno is None:
        stream.seek(0, os.SEEK_END)
        stream.write(bytes(65536))
        stream.flush()


def _write_whole(stream: RawIOBase, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[stream.write(rest) or 0 :]


def _split(content: bytes) -> tuple[bytes, bytes]:
    """What ends with a newline, and what comes after the last one."""
    end = content.rfind(b"\n") + 1
    return content[:end], content[end:]


def _parsed(line: bytes) -> dict[str, Any] | None:
    try:
        content = json.loads(line)
    except ValueError:
        return None
    return content if isinstance(content, dict) else None
