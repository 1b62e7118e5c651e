"""The rig with everything that runs on it: what a service, or a program in the same process, commands and asks.

Every method may be called from any thread. Those that ask (`rig_status`, `runs`, ...) never wait for an instrument;
those that command end within a bound.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Collection
from dataclasses import replace
from typing import Literal

from irpmd_rig.acquisition.book import RunBook
from irpmd_rig.acquisition.by_hand import ByHand
from irpmd_rig.acquisition.chores import Chores
from irpmd_rig.acquisition.conduct import Ending
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.hands import Hands, Zeros
from irpmd_rig.acquisition.intake import Intake, RecipeText, named_recipe
from irpmd_rig.acquisition.interlocks import NotReady, instruments_of, rig_reasons
from irpmd_rig.acquisition.lease import Lease, LeaseBook
from irpmd_rig.acquisition.ownership import AlreadyRunning, lock_store
from irpmd_rig.acquisition.queue import RunQueue
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.rig_file import RigFile
from irpmd_rig.acquisition.runner import Runner, Workplace
from irpmd_rig.acquisition.safety import Overdue, Safety, bounded
from irpmd_rig.acquisition.sequencer import PROMPT_LIMIT_S
from irpmd_rig.acquisition.status import QueueStatus, RigStatus, RunStatus, StopReport, Validation
from irpmd_rig.acquisition.steering import END_LIMIT_S, Action, Wish, steer
from irpmd_rig.acquisition.watch import Seen, Watch
from irpmd_rig.processing import Worker
from irpmd_rig.store.errors import DiskFull
from irpmd_rig.store.library import REFERENCE, Library, LibraryItem
from irpmd_rig.store.record import CALIBRATIONS
from irpmd_rig.store.states import Reason, RunState
from irpmd_rig.store.store import Store

CLOSE_LIMIT_S = 20.0

_log = logging.getLogger(__name__)


class RigDaemon:
    """A rig, its queue and its store.

    Parameters
    ----------
    rig_file
        What `irpmd_rig.acquisition.rig_file.read_rig` returned; the store is at its ``storage.root``.
    threads
        On which results are computed.
    prompt_limit_s
        How long a run waits for a person before it fails.

    Attributes
    ----------
    events : EventLog
        What happens; subscribe to it.
    hand : ByHand
        Commands to single instruments; the caller checks the lease first (`check_lease`).
    store : Store
        The runs' folders: frames, results, exports.
    """

    def __init__(self, rig_file: RigFile, *, threads: int = 2, prompt_limit_s: float = PROMPT_LIMIT_S) -> None:
        self.events = EventLog()
        # Locked first: a store clears away what an earlier process left half made.
        self._lock_file: int | None = lock_store(rig_file.storage.root)
        self._closing = threading.Lock()
        self.store = Store(rig_file.storage.root)
        self._rig = Rig(rig_file)
        self._threads = threads
        self._prompt_limit_s = prompt_limit_s
        self._library = Library(self.store)
        self._leases = LeaseBook()
        self._queue = RunQueue()
        self._hands = Hands()
        self._zeros = Zeros()
        self._safety = Safety(self._rig, self.events)
        self._watch = Watch(
            self._rig,
            self._safety,
            self._hands,
            self._zeros,
            self.events,
            lost=self._device_lost,
        )
        self._intake = Intake(
            lambda: self._rig.file, lambda: self._watch.seen.equipment, self._positions_mm, self.store
        )
        self._book = RunBook(self.store, self._queue, self.events, self._intake)
        self.hand = ByHand(self._rig, self._safety, self._hands, self._zeros, self._watch.look)
        chores = Chores(self._book, self.store, self._leases, self.hand, rig_file.storage.retention_days)
        self._watch.chores.append(chores)
        self._worker: Worker | None = None
        self._runner: Runner | None = None

    # --- life

    def start(self) -> None:
        """Recover what an earlier daemon left, open the instruments, make them safe, and begin to take runs.

        Instruments that are missing do not prevent it: see `rig_status`. The queue is held.

        Raises
        ------
        SimulationError
            The rig's simulated world does not start.
        """
        try:
            self._rig.open()
            self._safety.make_safe()
            interrupted = self._book.recover()
            if interrupted:
                self._queue.hold(f"the daemon was started; interrupted: {', '.join(interrupted)}")
            self._zeros.given(*self._rig.stages)
            self._worker = Worker(self.store.root, threads=self._threads)
            self._runner = Runner(self._workplace(self._worker))
            self._watch.start()
            self._runner.start()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Interrupt the run under way, make the instruments safe, close everything; never raises, may be repeated."""
        with self._closing:
            self._close()

    def _close(self) -> None:
        if self._runner is not None:
            self._runner.close(CLOSE_LIMIT_S)
        self._watch.close(CLOSE_LIMIT_S)
        self._safety.make_safe()
        try:
            bounded(self._rig.close, CLOSE_LIMIT_S)
        except Overdue:
            _log.error("the instruments were not closed within %g s", CLOSE_LIMIT_S)
        if self._worker is not None:
            self._worker.close()
        self.events.close()
        self.store.close()
        descriptor, self._lock_file = self._lock_file, None
        if descriptor is not None:
            os.close(descriptor)

    def __enter__(self) -> RigDaemon:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- the rig

    def rig_status(self) -> RigStatus:
        """Tell what the rig is doing, and every reason why a run would not begin now."""
        seen, run_id = self._watch.seen, self._hands.run_id
        held = self._queue.why_held
        holder = self._leases.holder()
        reasons = self._not_ready(seen)
        if holder is not None:
            reasons.append(f"the rig is controlled by hand by {holder.owner}: its lease has to end")
        if run_id is not None:
            reasons.append(f"run {run_id} is under way")
        if held:
            reasons.append(f"the queue is held: {held} (resume it)")
        try:
            self._intake.check_space()
        except DiskFull as error:
            reasons.append(str(error))
        return RigStatus(
            name=self._rig.file.name,
            simulated=self._rig.simulated,
            devices=self._rig.devices,
            axes=seen.axes,
            lease=holder,
            active_run=run_id,
            stop_latched=self._safety.latched,
            can_start=not reasons,
            reasons=tuple(reasons),
            free_bytes=self.store.free_bytes(),
            time_s=seen.time_s,
        )

    def stop(self) -> dict[str, StopReport]:
        """Stop everything now, and let nothing start until `clear_stop`; needs no lease.

        Returns
        -------
        dict
            What was achieved, for every instrument.
        """
        self._safety.latch()
        self._queue.hold("everything was stopped")
        runner = self._runner
        run = None if runner is None else runner.active
        if run is not None:
            run.conduct.end(Ending(RunState.FAILED, Reason.STOPPED, "everything was stopped: clear it, then retry"))
        reports = self._safety.make_safe()
        if runner is not None and not runner.end_active(
            Ending(RunState.FAILED, Reason.STOPPED, "everything was stopped"), END_LIMIT_S
        ):
            _log.error("run %s does not end within %g s", run and run.id, END_LIMIT_S)
        self._watch.look()
        self.events.announce("stop", latched=True)
        return reports

    def clear_stop(self) -> None:
        """Allow starting again; the queue stays held."""
        self._safety.clear()

    # --- the lease

    def take_lease(self, owner: str, duration_s: float, *, override: bool = False) -> Lease:
        """Take control by hand; raises LeaseHeld or BadLease."""
        lease = self._leases.take(owner, duration_s, override=override)
        if lease.overridden is not None:
            _log.warning("%s took the lease from %s", owner, lease.overridden)
        self.events.announce("lease", owner=lease.owner, expires_s=lease.expires_s, overridden=lease.overridden)
        return lease

    def renew_lease(self, lease_id: str | None, duration_s: float) -> Lease:
        """Let it end `duration_s` from now; raises LeaseHeld, LeaseNeeded or BadLease."""
        lease = self._leases.renew(lease_id, duration_s)
        self.events.announce("lease", owner=lease.owner, expires_s=lease.expires_s, overridden=lease.overridden)
        return lease

    def release_lease(self, lease_id: str | None) -> None:
        """Give it back, and make the rig safe; raises LeaseHeld or LeaseNeeded."""
        self._leases.release(lease_id)
        self.hand.leave_safe()
        self.events.announce("lease", owner=None, expires_s=None, overridden=None)
        self._wake()

    def check_lease(self, lease_id: str | None) -> Lease:
        """Pass the lease that is in force; raises LeaseHeld (with its holder) or LeaseNeeded."""
        return self._leases.check(lease_id)

    # --- runs

    def validate(self, recipe: RecipeText) -> Validation:
        """Tell everything that is wrong with a recipe, and what it would take; nothing is run or kept."""
        return self._intake.validate(recipe)

    def submit(self, recipe: RecipeText, idempotency_key: str | None = None) -> tuple[RunStatus, bool]:
        """Make a run of a recipe (its text, or `named_recipe`) and let it wait; returns it, and whether it is new.

        Raises
        ------
        DocumentError
            Everything that is wrong with the recipe.
        DiskFull
            It would not fit.
        KeyReused, BadKey
            The idempotency key belongs to another recipe, or is none.
        """
        status, new = self._book.submit(recipe, self._rig.file, idempotency_key)
        status = self._placed(status)
        self._wake()
        return status, new

    def runs(self) -> tuple[RunStatus, ...]:
        """All runs, newest first."""
        return tuple(self._placed(status) for status in self._book.statuses())

    def run(self, run_id: str) -> RunStatus:
        """One run; raises RunNotFound."""
        return self._placed(self._book.status(run_id))

    def act(
        self, run_id: str, action: Action, lease_id: str | None, answer: str = "done", prompt: int | None = None
    ) -> RunStatus:
        """Act on a run.

        Parameters
        ----------
        run_id, lease_id
            Which run; the lease of whoever asks.
        action
            ``abort`` ends it, also while it waits. ``pause`` takes hold before the next station. ``resume`` goes on.
            ``answer`` answers the operator's prompt: ``done``, or ``abort``. ``retry`` opens it again, at the end of
            the queue.
        answer
            The answer.
        prompt
            The id of the prompt that it is for: a prompt that came since is then not answered unseen. None: whichever
            waits.

        Raises
        ------
        LeaseHeld, LeaseNeeded
            The lease is somebody else's, or nobody's.
        ActionRefused
            The run's state does not allow it.
        RunNotFound, RunFolderError, DocumentError, DiskFull
            The run is not there, cannot be read, or its next state cannot be written.
        """
        owner = self._leases.check(lease_id).owner
        if action == "retry":
            self._book.retry(run_id)
            self._wake()
        else:
            steer(self._book, self._queue, self._runner, Wish(run_id, action, owner, answer, prompt))
        return self.run(run_id)

    def delete(self, run_id: str) -> None:
        """Delete an ended run with its folder; raises RunNotFound, RunInUse or WriteFailed."""
        self._book.delete(run_id)

    # --- the queue

    def queue_status(self) -> QueueStatus:
        """Tell what waits, and whether it may start."""
        why = self._queue.why_held
        return QueueStatus(bool(why), why, self._queue.waiting(), self._hands.run_id)

    def queue_action(self, action: Literal["hold", "resume"]) -> QueueStatus:
        """Hold the queue, or let it go on.

        Raises
        ------
        NotReady
            The rig could not begin a run now: every reason.
        """
        if action == "hold":
            self._queue.hold("held by hand")
        else:
            reasons = self._not_ready(self._watch.seen)
            if reasons:
                raise NotReady("; ".join(reasons), "then resume the queue")
            self._queue.resume()
        status = self.queue_status()
        self.events.announce("queue", held=status.held, why=status.why, waiting=list(status.waiting))
        self._wake()
        return status

    # --- calibrations and references

    def calibrations(self) -> tuple[LibraryItem, ...]:
        """Calibrations that measurements may use, newest first."""
        return self._library.calibrations()

    def references(self) -> tuple[LibraryItem, ...]:
        """References that measurements may use, newest first."""
        return self._library.references()

    def activate(self, run_id: str, kinds: Collection[str] = (*CALIBRATIONS, REFERENCE)) -> LibraryItem:
        """Let recipes that say `active` get this one, of one of these kinds; raises RunNotFound or NotUsable."""
        return self._library.activate(run_id, kinds)

    # --- inside

    def _workplace(self, worker: Worker) -> Workplace:
        return Workplace(
            rig=self._rig,
            safety=self._safety,
            hands=self._hands,
            zeros=self._zeros,
            book=self._book,
            queue=self._queue,
            library=self._library,
            worker=worker,
            may_start=lambda: not self._safety.latched and self._leases.holder() is None,
            check_space=lambda run: self._intake.check_space(run.estimate),
            prompt_limit_s=self._prompt_limit_s,
        )

    def _not_ready(self, seen: Seen) -> list[str]:
        """Reasons that lie with the rig itself."""
        without_zero = [name for name, axis in seen.axes.items() if axis.position is None]
        reasons = rig_reasons(self._rig, self._needed(), without_zero)
        reasons += [f"{name} could not be made safe: {why}" for name, why in self._safety.concerns.items()]
        if self._safety.latched:
            reasons.append("everything was stopped: clear the stop when it is safe to go on")
        return reasons

    def _needed(self) -> frozenset[str]:
        """Instruments of the run that is next; all, where none waits or it cannot be read."""
        run_id = self._queue.first()
        run = None if run_id is None else self._book.known(run_id)
        return frozenset(self._rig.devices) if run is None else instruments_of(run.plan)

    def _placed(self, status: RunStatus) -> RunStatus:
        waiting = self._queue.waiting()
        return replace(status, place=waiting.index(status.id)) if status.id in waiting else status

    def _positions_mm(self) -> dict[str, float]:
        axes = self._watch.seen.axes
        return {name: axis.position.position_mm for name, axis in axes.items() if axis.position is not None}

    def _device_lost(self, name: str) -> None:
        if not self._queue.why_held:
            self._queue.hold(f"{name} was lost")

    def _wake(self) -> None:
        if self._runner is not None:
            self._runner.wake()


__all__ = ["Action", "AlreadyRunning", "RigDaemon", "named_recipe"]
