"""The folder of a run: what it is, what state it is in, its frames and its results."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from irpmd_rig.store.durable import PART, Journal, typed_errors
from irpmd_rig.store.entries import ManifestEntry, Role, Withdrawal, parse_line
from irpmd_rig.store.errors import FileNotInRun, RunFolderError, TransitionRefused, all_problems
from irpmd_rig.store.frame_file import (
    FRAMES,
    Image,
    checked_image,
    checksum,
    described_entry,
    frame_path,
    read_image,
)
from irpmd_rig.store.paths import file_within
from irpmd_rig.store.record import RunRecord, read_record, write_record
from irpmd_rig.store.results import Results
from irpmd_rig.store.states import Transition, check_transition
from irpmd_rig.store.writer import FrameWriter

_TRANSITION = TypeAdapter(Transition)
_NUMBER = re.compile(r"(\d{5,})_")


@dataclass(frozen=True, slots=True)
class Reconciliation:
    """What a run's folder looked like after a crash.

    Attributes
    ----------
    frames
        Frames of the manifest whose files are good.
    recovered
        Frames that were on disk without a line in the manifest; they have one now.
    lost
        Frames of the manifest whose files are missing or damaged; they are taken out.
    removed
        Unfinished files that were deleted.
    unknown
        Files among the frames that are no frame of this run; they are left alone.
    """

    frames: int
    recovered: tuple[str, ...]
    lost: tuple[str, ...]
    removed: tuple[str, ...]
    unknown: tuple[str, ...]


class RunFolder:
    """A run's folder. One object of one process writes it at a time; others may read it meanwhile.

    Parameters
    ----------
    path
        The folder; a folder written by hand needs `run.yaml`, `manifest.jsonl` and the frames that it names.
    on_transition
        Called after each transition is on disk.
    """

    def __init__(self, path: Path, on_transition: Callable[[RunFolder], None] | None = None) -> None:
        self.path = path
        self.results = Results(path / "results")
        self._on_transition = on_transition
        self._states = Journal(path / "state.jsonl")
        self._manifest = Journal(path / "manifest.jsonl")
        self._writer = FrameWriter(path, self._manifest)
        # Two locks: a change of state never waits for the disk to take frames.
        self._state_lock = threading.Lock()
        self._frame_lock = threading.Lock()
        self._next_index: int | None = None
        self._record: tuple[tuple[int, int, int], RunRecord] | None = None

    @property
    def id(self) -> str:
        """The run's id: the folder's name."""
        return self.path.name

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Write what waits, and end the writer's thread; raises as `flush` does."""
        self._writer.close()

    # What it is

    def record(self) -> RunRecord:
        """What `run.yaml` says, read again if it changed; raises RunFolderError."""
        path = self.path / "run.yaml"
        try:
            stamp = path.stat()
        except OSError:
            return read_record(path)  # which says what is wrong
        state = (stamp.st_mtime_ns, stamp.st_size, stamp.st_ino)
        if self._record is None or self._record[0] != state:
            self._record = (state, read_record(path))
        return self._record[1]

    def amend(self, **changes: Any) -> RunRecord:
        """Change fields of `run.yaml` (see RunRecord), e.g. ``optics`` or ``uses`` once they are known.

        Raises
        ------
        RunFolderError
            If a value is wrong.
        """
        try:
            record = RunRecord.model_validate(self.record().model_dump() | changes)
        except ValidationError as error:
            raise RunFolderError(f"{self.path / 'run.yaml'}: {all_problems(error)}") from error
        write_record(record, self.path / "run.yaml")
        return record

    def recipe_text(self) -> str | None:
        """The recipe as it was given, with its comments; None if there is none."""
        try:
            return (self.path / "recipe.yaml").read_text(encoding="utf-8")
        except FileNotFoundError:
            return None

    # What state it is in

    def append_state(self, transition: Transition) -> None:
        """Enter a change of state; it is on disk when this returns.

        Raises
        ------
        TransitionRefused
            If the transition table does not know it.
        DiskFull, WriteFailed
            If it could not be written: the state is the old one then.
        """
        with self._state_lock:
            check_transition(self.state(), transition)
            self._states.append([_TRANSITION.dump_json(transition).decode()])
        if self._on_transition is not None:
            self._on_transition(self)

    def states(self) -> tuple[Transition, ...]:
        """All changes of state, oldest first; none if the folder was written by hand."""
        changes = []
        for number, line in self._states.read():
            try:
                changes.append(_TRANSITION.validate_python(line))
            except (ValidationError, TransitionRefused) as error:
                raise RunFolderError(f"{self._states.path}:{number}: {all_problems(error)}") from error
        return tuple(changes)

    def state(self) -> Transition | None:
        """The last change of state."""
        states = self.states()
        return states[-1] if states else None

    def state_bytes(self) -> int:
        """Length of `state.jsonl`, which only grows; 0 if there is none."""
        try:
            return self._states.path.stat().st_size
        except FileNotFoundError:
            return 0

    # Its frames

    def write_frame(self, image: Image, entry: ManifestEntry) -> ManifestEntry:
        """Hand a frame over to be written; it is durable after the next `flush`.

        Parameters
        ----------
        image
            uint8 or uint16, (H, W); not to be changed afterwards.
        entry
            How it was taken; ``path``, ``index`` and ``sha256`` are given by the folder.

        Returns
        -------
        ManifestEntry
            With path and index.

        Raises
        ------
        RunFolderError
            If the image is no frame.
        DiskFull, WriteFailed
            If this or an earlier frame could not be written; those that are in the manifest are good.
        """
        checked_image(image)
        with self._frame_lock:
            if self._next_index is None:
                self._next_index = self._first_free_index()
            entry = entry.model_copy(update={"index": self._next_index, "sha256": None})
            entry = entry.model_copy(update={"path": frame_path(entry)})
            self._next_index += 1
            self._writer.put(image, entry)
        return entry

    def flush(self) -> None:
        """Wait until every frame that was handed over is durable; raises DiskFull or WriteFailed."""
        self._writer.flush()

    def manifest(self) -> tuple[ManifestEntry, ...]:
        """Entries of the frames that count, oldest first: without superseded and lost ones.

        Fringe counts and steps that a line does not give are those of `run.yaml`.

        Raises
        ------
        RunFolderError
            If a line, but a torn last one, is wrong.
        """
        entries, withdrawn = self._read_manifest()
        return tuple(entry for entry in entries if entry.index not in withdrawn)

    def frames(
        self, *, station: int | None = None, label: str | None = None, role: Role | None = None
    ) -> tuple[ManifestEntry, ...]:
        """Entries of the manifest of one station, label or role; None takes all."""
        return tuple(
            entry
            for entry in self.manifest()
            if station in (None, entry.station) and label in (None, entry.label) and role in (None, entry.role)
        )

    def read_frame(self, entry: ManifestEntry) -> Image:
        """Read a frame.

        Returns
        -------
        ndarray of uint8 or uint16, (H, W)

        Raises
        ------
        RunFolderError
            If its file is missing, lies outside the folder, or is no frame.
        """
        return read_image(self.frame_file(entry))

    def frame_file(self, entry: ManifestEntry) -> Path:
        """File of a frame; raises RunFolderError if it is missing or lies outside the folder."""
        try:
            return self.file(entry.path)
        except FileNotInRun as error:
            raise RunFolderError(f"frame {entry.index} of {self.path}: {error}") from error

    def supersede(self, entries: Iterable[ManifestEntry]) -> None:
        """Take frames out, because a later attempt replaces them; their files stay."""
        indices = tuple(entry.index for entry in entries)
        if indices:
            self.flush()
            self._manifest.append([Withdrawal(superseded=indices).line()])

    def file(self, name: str) -> Path:
        """Path of a file of this run by its relative name; raises FileNotInRun."""
        return file_within(self.path, name)

    # After a crash

    def reconcile(self) -> Reconciliation:
        """Let manifest and frames agree after a process was killed; nothing good is deleted.

        Raises
        ------
        RunFolderError
            If the manifest is damaged before its last line.
        DiskFull, WriteFailed
            If the manifest could not be written.
        """
        self.flush()
        self._states.mend()
        self._manifest.mend()
        removed = self._remove_unfinished()
        entries, withdrawn = self._read_manifest()
        lost = [entry for entry in entries if entry.index not in withdrawn and not self._is_good(entry)]
        recovered, unknown = self._find_strays({entry.path for entry in entries})
        lines = [entry.line() for entry in recovered]
        # A frame that an earlier attempt left behind was taken again since.
        state = self.state()
        stale = tuple(entry.index for entry in recovered if state is not None and entry.attempt < state.attempt)
        withdrawal = Withdrawal(superseded=stale, lost=tuple(entry.index for entry in lost))
        if stale or lost:
            lines.append(withdrawal.line())
        if lines:
            self._manifest.append(lines)
        self._next_index = None
        return Reconciliation(
            frames=len(self.manifest()),
            recovered=tuple(entry.path for entry in recovered),
            lost=tuple(entry.path for entry in lost),
            removed=removed,
            unknown=unknown,
        )

    def _read_manifest(self) -> tuple[list[ManifestEntry], set[int]]:
        entries: list[ManifestEntry] = []
        withdrawn: set[int] = set()
        defaults = self._defaults()
        for number, content in self._manifest.read():
            try:
                line = parse_line(content)
            except ValueError as error:
                raise RunFolderError(f"{self._manifest.path}:{number}: {all_problems(error)}") from error
            if isinstance(line, Withdrawal):
                withdrawn.update(line.superseded, line.lost)
                continue
            missing = {key: value for key, value in defaults.items() if getattr(line, key) is None}
            missing |= {"index": len(entries)} if line.index < 0 else {}
            entries.append(line.model_copy(update=missing))
        return entries, withdrawn

    def _defaults(self) -> dict[str, Any]:
        fringes = self.record().fringes
        return {} if fringes is None else {"counts": fringes.counts, "steps": fringes.steps}

    def _first_free_index(self) -> int:
        """Above every number that was ever given: a file is never replaced."""
        entries, _ = self._read_manifest()
        used = [entry.index for entry in entries]
        used += [int(match[1]) for path in self._frame_files() if (match := _NUMBER.match(path.name))]
        with typed_errors(self.path / FRAMES):
            (self.path / FRAMES).mkdir(exist_ok=True)
        return max(used, default=-1) + 1

    def _frame_files(self) -> list[Path]:
        folder = self.path / FRAMES
        return sorted(path for path in folder.iterdir() if path.is_file()) if folder.is_dir() else []

    def _remove_unfinished(self) -> tuple[str, ...]:
        unfinished = [*self.path.glob(f"*{PART}"), *self.path.glob(f"{FRAMES}/*{PART}")]
        unfinished += self.path.glob(f"results/*{PART}")
        for path in unfinished:
            with typed_errors(path):
                path.unlink()
        return tuple(str(path.relative_to(self.path)) for path in unfinished)

    def _is_good(self, entry: ManifestEntry) -> bool:
        try:
            path = self.frame_file(entry)
            if entry.sha256 is not None:
                return checksum(path) == entry.sha256
            read_image(path)
        except (RunFolderError, OSError):
            return False
        return True

    def _find_strays(self, known: set[str]) -> tuple[list[ManifestEntry], tuple[str, ...]]:
        recovered, unknown = [], []
        for path in self._frame_files():
            name = f"{FRAMES}/{path.name}"
            if name in known:
                continue
            entry = described_entry(path)
            if entry is not None and entry.path == name:
                recovered.append(entry)
            else:
                unknown.append(name)
        return recovered, tuple(unknown)
