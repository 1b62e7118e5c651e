"""Errors of the store: what was wrong, and what to do about it."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError


class StoreError(Exception):
    """Base of every error of the store."""


class RunNotFound(StoreError):
    """There is no run of this id."""


class FileNotInRun(StoreError):
    """A path that is not a file of this run: missing, outside its folder, or through a symbolic link."""


class RunFolderError(StoreError):
    """A run folder that cannot be read: `run.yaml`, `manifest.jsonl`, `state.jsonl` or a frame is wrong."""


class TransitionRefused(StoreError):
    """A change of state that the transition table does not know."""


class RunInUse(StoreError):
    """A run that cannot be deleted now: it has not ended, or a measurement may use it."""


class NotUsable(StoreError):
    """A run that cannot serve as a calibration or reference."""


class ExportError(StoreError):
    """An export of something that the run does not hold."""


class WriteFailed(StoreError):
    """The disk refused to write for another reason than want of room."""


class DiskFull(StoreError):
    """There is no room for what is to be written; what was written before is good.

    Parameters
    ----------
    path
        Where it was to be written.
    needed_bytes
        What was asked for, with the reserve; None where a write failed without saying.
    free_bytes
        What was free then.
    """

    def __init__(self, path: Path, needed_bytes: int | None, free_bytes: int) -> None:
        super().__init__(path, needed_bytes, free_bytes)
        self.path = path
        self.needed_bytes = needed_bytes
        self.free_bytes = free_bytes

    def __str__(self) -> str:
        needed = "" if self.needed_bytes is None else f" of the {self.needed_bytes / 1e6:.1f} MB needed"
        return (
            f"no room at {self.path}: {self.free_bytes / 1e6:.1f} MB are free{needed};"
            " delete or move old runs, or choose another storage root in the rig file"
        )


def all_problems(error: Exception) -> str:
    """What is wrong in one line; of pydantic's errors every problem with its place."""
    if not isinstance(error, ValidationError):
        return str(error)
    return "; ".join(
        f"{'.'.join(str(part) for part in problem['loc']) or 'the whole'}: {problem['msg']}"
        for problem in error.errors(include_url=False)
    )
