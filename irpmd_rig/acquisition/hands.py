"""Who has the instruments in hand at this moment: a run, a person's command, or the watch that looks after them."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from irpmd_rig.acquisition.errors import AcquisitionError

# A command waits this long for another one, or for the watch, which may be opening an instrument.
WAIT_S = 30.0


class RigBusy(AcquisitionError):
    """The instruments are in use.

    Attributes
    ----------
    run_id
        The run that has them; None: another command.
    """

    def __init__(self, run_id: str | None) -> None:
        who = "another command" if run_id is None else f"run {run_id}"
        super().__init__(f"the instruments are in use by {who}", "wait for its end, or abort it")
        self.run_id = run_id


class Hands:
    """One user of the instruments at a time.

    A run keeps them from its beginning to its end, but lets others look (take frames, show patterns) while it waits
    for a person.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._run_id: str | None = None
        self._at_ease = False

    @property
    def run_id(self) -> str | None:
        """The run that has the instruments."""
        return self._run_id

    @contextmanager
    def of_run(self, run_id: str) -> Iterator[None]:
        """Have them for a run."""
        with self._lock:
            self._run_id = run_id
            try:
                yield
            finally:
                self._run_id = None

    @contextmanager
    def at_ease(self) -> Iterator[None]:
        """Let others look, while the run that has them waits for a person."""
        self._at_ease = True
        self._lock.release()
        try:
            yield
        finally:
            self._at_ease = False
            self._lock.acquire()

    @contextmanager
    def of_person(self, *, looking: bool = False, wait_s: float = WAIT_S) -> Iterator[None]:
        """Have them for one command.

        Parameters
        ----------
        looking
            The command moves nothing.
        wait_s
            How long another command is waited for.

        Raises
        ------
        RigBusy
            A run has them, or another command does not end.
        """
        self._refuse_run(looking)
        if not self._lock.acquire(timeout=wait_s):
            raise RigBusy(self._run_id)
        try:
            self._refuse_run(looking)
            yield
        finally:
            self._lock.release()

    @contextmanager
    def of_watch(self) -> Iterator[bool]:
        """Have them if nobody else does; yields whether that is so."""
        free = self._run_id is None and self._lock.acquire(blocking=False)
        try:
            yield free and self._run_id is None
        finally:
            if free:
                self._lock.release()

    def _refuse_run(self, looking: bool) -> None:
        if self._run_id is not None and not (looking and self._at_ease):
            raise RigBusy(self._run_id)


class Zeros:
    """Counts how often each axis was given its zero: frames of two zeros are never mixed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    def given(self, *axes: str) -> None:
        """Take note that these axes were homed, zeroed, or opened again."""
        with self._lock:
            self._counts.update(axes)

    def now(self) -> dict[str, int]:
        """Return the number of the zero in force, by axis."""
        with self._lock:
            return dict(self._counts)
