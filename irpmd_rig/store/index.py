"""The index of all runs: SQLite beside the folders, which are the truth. It may be deleted at any time."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterable
from dataclasses import astuple, fields
from datetime import datetime
from pathlib import Path
from typing import Any

from irpmd_rig.store.states import Reason, RunState
from irpmd_rig.store.summary import RunSummary

_COLUMNS = (
    "id TEXT PRIMARY KEY, kind TEXT, name TEXT, operator TEXT, sample TEXT, created TEXT, state TEXT, reason TEXT,"
    " detail TEXT, attempt INTEGER, queue_order INTEGER, key TEXT, changed TEXT, state_bytes INTEGER"
)
_WAIT_S = 5.0


class Index:
    """Summaries of runs by id, newest first; safe to use from several threads and processes.

    Parameters
    ----------
    path
        The database. One that cannot be read is thrown away.

    Raises
    ------
    sqlite3.Error
        From every method, if the disk refuses.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        try:
            self._database = self._connect()
        except sqlite3.DatabaseError:
            delete_index(path)
            self._database = self._connect()

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._database.close()

    def put(self, summaries: Iterable[RunSummary]) -> None:
        """Enter runs, or replace what is known of them."""
        marks = ", ".join("?" * len(fields(RunSummary)))
        rows = [tuple(_stored(value) for value in astuple(summary)) for summary in summaries]
        with self._lock, self._database:
            self._database.executemany(f"INSERT OR REPLACE INTO runs VALUES ({marks})", rows)

    def remove(self, ids: Iterable[str]) -> None:
        """Forget runs."""
        with self._lock, self._database:
            self._database.executemany("DELETE FROM runs WHERE id = ?", [(run_id,) for run_id in ids])

    def all(self) -> tuple[RunSummary, ...]:
        """All runs."""
        with self._lock:
            rows = self._database.execute("SELECT * FROM runs").fetchall()
        return tuple(_summary(row) for row in rows)

    def _connect(self) -> sqlite3.Connection:
        database = sqlite3.connect(self._path, timeout=_WAIT_S, check_same_thread=False)
        try:
            database.execute("PRAGMA journal_mode = WAL")
            database.execute("PRAGMA synchronous = NORMAL")
            database.execute(f"CREATE TABLE IF NOT EXISTS runs ({_COLUMNS}) STRICT")
            if len(database.execute("PRAGMA table_info(runs)").fetchall()) != len(fields(RunSummary)):
                raise sqlite3.DatabaseError("a table of another version")
            database.commit()
        except sqlite3.Error:
            database.close()
            raise
        return database


def delete_index(path: Path) -> None:
    """Delete a database with the files that SQLite keeps beside it."""
    for suffix in ("", "-wal", "-shm"):
        path.with_name(path.name + suffix).unlink(missing_ok=True)


def _stored(value: object) -> object:
    return value.isoformat() if isinstance(value, datetime) else value


def _summary(row: tuple[Any, ...]) -> RunSummary:
    summary = dict(zip((field.name for field in fields(RunSummary)), row, strict=True))
    readers = {
        "created": datetime.fromisoformat,
        "changed": datetime.fromisoformat,
        "state": RunState,
        "reason": Reason,
    }
    for name, read in readers.items():
        summary[name] = None if summary[name] is None else read(summary[name])
    return RunSummary(**summary)
