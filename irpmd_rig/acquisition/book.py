"""All runs of the rig: taken in once, listed, found again after a restart, opened again, deleted."""

from __future__ import annotations

import logging
import threading
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime

from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.intake import Intake, Order, RecipeText
from irpmd_rig.acquisition.interlocks import record_of
from irpmd_rig.acquisition.queue import RunQueue
from irpmd_rig.acquisition.rig_file import RigFile
from irpmd_rig.acquisition.runs import Run
from irpmd_rig.acquisition.status import RunStatus
from irpmd_rig.processing.whole import withdraw_partial
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.store.errors import RunFolderError, StoreError
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import ENDED_BADLY, Reason, RunState, Transition
from irpmd_rig.store.store import Store
from irpmd_rig.store.summary import RunSummary, summarise

KEY_LIMIT = 200

_log = logging.getLogger(__name__)


class RecipeRefused(DocumentError):
    """A recipe that can be read, but not run on this rig: see its problems."""


class KeyReused(AcquisitionError):
    """An idempotency key under which another recipe was submitted."""


class BadKey(AcquisitionError):
    """An idempotency key that cannot be one."""


class ActionRefused(AcquisitionError):
    """An action that a run cannot follow in its state."""


class RunBook:
    """The runs of a store, those under way among them; safe to use from any thread.

    Parameters
    ----------
    store, queue, events
        Where runs are kept, wait and are announced.
    intake
        Reads recipes.
    """

    def __init__(self, store: Store, queue: RunQueue, events: EventLog, intake: Intake) -> None:
        self._store = store
        self._queue = queue
        self._events = events
        self._intake = intake
        self._lock = threading.RLock()
        self._live: dict[str, Run] = {}

    # --- after a start

    def recover(self) -> tuple[str, ...]:
        """Let the runs that an earlier daemon left be interrupted, or wait again; returns the interrupted ones.

        Whatever is wrong with one folder does not hide the others.
        """
        interrupted = []
        for summary in self._store.runs():
            self._queue.seen(summary.order)
            if summary.state is None or summary.state.final:
                continue
            try:
                if self._recovered(self._store.run(summary.id)):
                    interrupted.append(summary.id)
            except (StoreError, OSError) as error:
                _log.error("run %s cannot be recovered: %s", summary.id, error)
        return tuple(interrupted)

    def _recovered(self, folder: RunFolder) -> bool:
        with folder:
            last = folder.state()
            if last is None or last.state.final:
                return False
            if last.state is RunState.QUEUED:
                self._queue.add(folder.id, last.order or self._queue.next_order())
                with suppress(DocumentError):
                    self.live(folder.id)
                return False
            found = folder.reconcile()
            # What was being computed when the daemon was killed is no result.
            withdraw_partial(folder.results)
            what = f"the daemon ended while the run was {last.state}; {found.frames} frames are good"
            after = replace(
                last,
                state=RunState.INTERRUPTED,
                reason=Reason.DAEMON_RESTARTED,
                detail=f"{what}: retry the run",
                time=datetime.now(UTC),
            )
            folder.append_state(after)
            _log.warning("run %s: %s", folder.id, what)
            return True

    # --- taking in

    def submit(self, given: RecipeText, rig_file: RigFile, key: str | None = None) -> tuple[RunStatus, bool]:
        """Make a run and let it wait; returns it, and whether it is new.

        Raises
        ------
        DocumentError
            The recipe cannot be read, or the rig cannot do it (`RecipeRefused`): everything that is wrong.
        DiskFull
            It, with the runs that wait, would not fit.
        KeyReused, BadKey
            The idempotency key belongs to another recipe, or is none.
        """
        if key is not None and not (0 < len(key) <= KEY_LIMIT and key.isprintable()):
            raise BadKey("the idempotency key is refused", f"give 1 to {KEY_LIMIT} printable characters")
        known = self._by_key(key, given)
        if known is not None:
            return known, False
        order = self._intake.read(given)
        if order.problems:
            raise RecipeRefused(order.problems)
        with self._lock:
            # Again: the same request may have come twice at the same time.
            known = self._by_key(key, given)
            if known is not None:
                return known, False
            self._intake.check_space(order.estimate, *(run.estimate for run in self._waiting()))
            place = self._queue.next_order()
            first = Transition(RunState.QUEUED, attempt=1, order=place, key=key)
            folder = self._store.create_run(record_of(order.recipe, rig_file), first, order.text)
            run = self._made(folder, order)
            self._queue.add(folder.id, place)
        self._events.announce("state", run.id, state=RunState.QUEUED, reason=None, detail="", attempt=1)
        return run.status(), True

    def _by_key(self, key: str | None, given: RecipeText) -> RunStatus | None:
        folder = None if key is None else self._store.run_by_key(key)
        if folder is None:
            return None
        if folder.recipe_text() != given.text:
            raise KeyReused("this idempotency key was used for another recipe", "give each request its own")
        return self.status(folder.id)

    def retry(self, run_id: str) -> RunStatus:
        """Open a run again that ended badly.

        Raises
        ------
        ActionRefused
            It has not ended, or has succeeded.
        RunNotFound, RunFolderError, DocumentError, DiskFull
            It is not there, cannot be read any more, or its next state cannot be written.
        """
        with self._lock:
            run = self.live(run_id)
            if run.state not in ENDED_BADLY:
                raise ActionRefused(f"the run is {run.state}", "only a run that ended badly can be retried")
            place = self._queue.next_order()
            run.requeue(place)
            self._queue.add(run_id, place)
            return run.status()

    # --- finding

    def live(self, run_id: str) -> Run:
        """Return a run as an object that can act; an older one is read from its folder.

        Raises
        ------
        RunNotFound, RunFolderError, DocumentError
            It is not there, or cannot be read.
        """
        with self._lock:
            run = self._live.get(run_id)
            if run is not None:
                return run
            folder = self._store.run(run_id)
            text = folder.recipe_text()
            if text is None or folder.state() is None:
                raise RunFolderError(f"run {run_id} was not made by the daemon: it has no recipe.yaml or state.jsonl")
            return self._made(folder, self._intake.read(RecipeText(text, f"{run_id}/recipe.yaml")))

    def known(self, run_id: str) -> Run | None:
        """Return a run that waits, is under way, or ended badly under this daemon; None: any other. Never waits."""
        return self._live.get(run_id)

    def status(self, run_id: str) -> RunStatus:
        """Tell everything about a run; raises RunNotFound."""
        run = self.known(run_id)
        folder = self._store.run(run_id)
        try:
            frames = len(folder.manifest())
        except StoreError:
            frames = 0
        if run is not None:
            return replace(run.status(), frames=frames)
        return replace(_status(summarise(folder)), frames=frames, results=folder.results.names())

    def statuses(self) -> tuple[RunStatus, ...]:
        """Tell of all runs, newest first."""
        summaries = self._store.runs()
        with self._lock:
            live = dict(self._live)
        return tuple(live[found.id].status() if found.id in live else _status(found) for found in summaries)

    def forget(self, run_id: str) -> None:
        """Keep a run that has succeeded no longer in memory."""
        with self._lock:
            self._live.pop(run_id, None)

    def delete(self, run_id: str) -> None:
        """Delete an ended run with its folder; raises RunNotFound, RunInUse or WriteFailed."""
        with self._lock:
            self._store.delete(run_id)
            self._live.pop(run_id, None)
        self._events.announce("state", run_id, state="deleted", reason=None, detail="", attempt=0)

    def save(self) -> None:
        """Write what the disk refused earlier."""
        with self._lock:
            runs = tuple(self._live.values())
        for run in runs:
            run.save()

    def _waiting(self) -> list[Run]:
        found = []
        for run_id in self._queue.waiting():
            try:
                found.append(self.live(run_id))
            except (StoreError, DocumentError) as error:
                _log.warning("run %s waits, but cannot be read: %s", run_id, error)
        return found

    def _made(self, folder: RunFolder, order: Order) -> Run:
        run = Run(folder, order.recipe, order.plan, order.estimate, self._events)
        self._live[run.id] = run
        return run


def _status(found: RunSummary) -> RunStatus:
    return RunStatus(
        id=found.id,
        kind=found.kind,
        name=found.name,
        state=found.state,
        reason=found.reason,
        detail=found.detail,
        attempt=found.attempt,
        created=found.created,
        changed=found.changed,
    )
