"""All runs of a rig: one folder each, and an index that can be made again from them."""

from __future__ import annotations

import logging
import re
import secrets
import shutil
import sqlite3
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from weakref import WeakValueDictionary

from irpmd_rig.store.active import ActiveRuns
from irpmd_rig.store.durable import Journal, free_bytes, sync_folder, typed_errors, write_text
from irpmd_rig.store.errors import DiskFull, RunFolderError, RunInUse, RunNotFound
from irpmd_rig.store.frame_file import FRAMES
from irpmd_rig.store.index import Index, delete_index
from irpmd_rig.store.record import RunRecord, software_versions, write_record
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Transition
from irpmd_rig.store.summary import RunSummary, summarise

_log = logging.getLogger(__name__)
_ID = re.compile(r"\d{8}-\d{6}-[0-9a-f]{6}")
_TIME_LETTERS = len("YYYYMMDD-HHMMSS")
_INDEX = "index.sqlite"
_NEW, _DELETED = ".new-", ".deleted-"
_LEFT_BEHIND_S = 60.0
# What a run writes beside its frames: texts and file system overhead.
_OVERHEAD_BYTES = 1_000_000


class Store:
    """The runs below a root folder. Safe to use from several threads; one process writes.

    Parameters
    ----------
    root
        The folder; it is made if it is not there.

    Raises
    ------
    DiskFull, WriteFailed
        If it cannot be made or written.
    """

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()
        with typed_errors(self.root):
            if not self.root.is_dir():
                self.root.mkdir(parents=True)
                sync_folder(self.root.parent)
            self.root = self.root.resolve()
            self._clear_away()
        self.active = ActiveRuns(self.root / "active.json")
        self._index: Index | None = None
        self._stale = True
        self._lock = threading.RLock()
        # Whoever asks for a run gets the same object while somebody holds it: a run has one writer.
        self._held: WeakValueDictionary[str, RunFolder] = WeakValueDictionary()
        self._refresh_index()

    def close(self) -> None:
        """Close the index."""
        if self._index is not None:
            self._index.close()
            self._index = None

    def create_run(self, record: RunRecord, first: Transition, recipe_text: str | None = None) -> RunFolder:
        """Make a run's folder; it is there whole and durable, or not at all.

        Parameters
        ----------
        record
            What it is; ``id`` and ``created`` are given here, ``versions`` if there are none.
        first
            Its first state: queued.
        recipe_text
            The recipe as it was given.

        Raises
        ------
        TransitionRefused
            If it does not begin as queued.
        DiskFull, WriteFailed
            If it could not be written.
        """
        created = datetime.now(UTC)
        run_id = f"{created:%Y%m%d-%H%M%S}-{secrets.token_hex(3)}"
        record = record.model_copy(
            update={"id": run_id, "created": created, "versions": record.versions or software_versions()}
        )
        beside = self.root / (_NEW + run_id)
        try:
            with typed_errors(beside):
                (beside / FRAMES).mkdir(parents=True)
            write_record(record, beside / "run.yaml")
            if recipe_text is not None:
                write_text(beside / "recipe.yaml", recipe_text)
            Journal(beside / "manifest.jsonl").append([])
            RunFolder(beside).append_state(first)
            with typed_errors(beside):
                beside.rename(self.root / run_id)
                sync_folder(self.root)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise
        folder = self.run(run_id)
        self._enter(folder)
        return folder

    def run(self, run_id: str) -> RunFolder:
        """The folder of a run; raises RunNotFound."""
        path = self.root / run_id
        if not _ID.fullmatch(run_id) or path.is_symlink() or not path.is_dir():
            raise RunNotFound(f"there is no run {run_id!r}")
        with self._lock:
            folder = self._held.get(run_id) or RunFolder(path, self._enter)
            self._held[run_id] = folder
        return folder

    def runs(self) -> tuple[RunSummary, ...]:
        """Summaries of all runs, newest first."""
        try:
            found = self._fresh_index().all()
        except sqlite3.Error as error:
            _log.warning("index of %s cannot be used (%s): the folders are read", self.root, error)
            found = tuple(summarise(folder) for folder in self._folders())
        return tuple(sorted(found, key=_age, reverse=True))

    def run_by_key(self, key: str) -> RunFolder | None:
        """The run that was made with this idempotency key."""
        return next((self.run(run.id) for run in self.runs() if run.key == key), None)

    def rebuild_index(self) -> None:
        """Throw the index away and make it again from the folders."""
        self.close()
        delete_index(self.root / _INDEX)
        self._refresh_index()

    def delete(self, run_id: str) -> None:
        """Delete an ended run with its folder.

        Raises
        ------
        RunNotFound
            If there is none.
        RunInUse
            If it has not ended, or a measurement may use it: it is active, or an active one was made with it.
        WriteFailed
            If the disk refuses.
        """
        folder = self.run(run_id)
        state = folder.state()
        if state is not None and not state.state.final:
            raise RunInUse(f"run {run_id} is {state.state}; abort it first")
        if run_id in self.needed():
            raise RunInUse(f"run {run_id} is an active calibration or reference, or one was made with it")
        with typed_errors(folder.path):
            away = folder.path.rename(self.root / (_DELETED + run_id))
            sync_folder(self.root)
            shutil.rmtree(away)
        self._note(lambda index: index.remove([run_id]))

    def needed(self) -> frozenset[str]:
        """Ids of the active calibrations and references, and of those that they were made with."""
        found: set[str] = set()
        waiting = list(self.active.read().values())
        while waiting:
            run_id = waiting.pop()
            if run_id not in found:
                found.add(run_id)
                try:
                    waiting += self.run(run_id).record().uses.values()
                except (RunNotFound, RunFolderError):
                    continue
        return frozenset(found)

    def delete_older(self, days: float, now: datetime | None = None) -> tuple[str, ...]:
        """Delete measurements and free sequences that ended more than ``days`` ago; returns their ids.

        Calibrations and references are kept, as are runs that are needed.
        """
        limit = (now or datetime.now(UTC)) - timedelta(days=days)
        needed = self.needed()
        old = [
            run.id
            for run in self.runs()
            if run.kind in ("measure", "sequence") and run.state is not None and run.state.final
            if run.changed is not None and run.changed < limit and run.id not in needed
        ]
        for run_id in old:
            self.delete(run_id)
        return tuple(old)

    def free_bytes(self) -> int:
        """Bytes that may still be written."""
        return free_bytes(self.root)

    def check_space(self, needed_bytes: int, reserve_bytes: int = 0) -> None:
        """Refuse to begin what would not fit; raises DiskFull.

        Parameters
        ----------
        needed_bytes
            Of frames and results.
        reserve_bytes
            What must be free afterwards.
        """
        needed, free = needed_bytes + reserve_bytes + _OVERHEAD_BYTES, self.free_bytes()
        if free < needed:
            raise DiskFull(self.root, needed, free)

    def _folders(self) -> list[RunFolder]:
        """All runs, oldest first."""
        paths = (path for path in self.root.iterdir() if _ID.fullmatch(path.name))
        return [self.run(path.name) for path in sorted(paths) if path.is_dir() and not path.is_symlink()]

    def _enter(self, folder: RunFolder) -> None:
        self._note(lambda index: index.put([summarise(folder)]))

    def _note(self, change: Callable[[Index], None]) -> None:
        """Change the index; if the disk refuses, it is made to agree with the folders when it is next asked."""
        try:
            if self._index is not None:
                change(self._index)
        except sqlite3.Error as error:
            _log.warning("index of %s not written: %s", self.root, error)
            self._stale = True

    def _refresh_index(self) -> None:
        try:
            self._fresh_index()
        except sqlite3.Error as error:
            _log.warning("index of %s cannot be used: %s", self.root, error)

    def _fresh_index(self) -> Index:
        with self._lock:
            if self._index is None:
                self._index = Index(self.root / _INDEX)
                self._stale = True
            if self._stale:
                known = {run.id: run.state_bytes for run in self._index.all()}
                folders = self._folders()
                self._index.remove(known.keys() - {folder.id for folder in folders})
                changed = [folder for folder in folders if known.get(folder.id) != folder.state_bytes()]
                self._index.put(summarise(folder) for folder in changed)
                self._stale = False
            return self._index

    def _clear_away(self) -> None:
        """Delete what a killed process left half made or half deleted."""
        for path in [*self.root.glob(_NEW + "*"), *self.root.glob(_DELETED + "*")]:
            # Another process may be at it right now; that takes no minute.
            if time.time() - path.stat().st_mtime > _LEFT_BEHIND_S:
                shutil.rmtree(path, ignore_errors=True)


def _age(run: RunSummary) -> tuple[str, datetime]:
    """Order of runs: by the time in their ids, and within a second by when they were made."""
    return run.id[:_TIME_LETTERS], run.created or datetime.min.replace(tzinfo=UTC)
