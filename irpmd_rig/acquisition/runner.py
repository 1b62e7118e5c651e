"""Takes runs from the queue, one at a time, and carries each to its end; the rig is safe whenever one has ended."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from drivers.protocols import DeviceFault, InstrumentError, Led, LimitReached, MotionFailed
from irpmd_rig.acquisition.book import RunBook
from irpmd_rig.acquisition.capture import CaptureSettings, Photographer
from irpmd_rig.acquisition.conduct import Conduct, Ending, RunEnded
from irpmd_rig.acquisition.endings import ending_of
from irpmd_rig.acquisition.hands import Hands, Zeros
from irpmd_rig.acquisition.interlocks import axes_of, check_start, has_zero, settle_uses
from irpmd_rig.acquisition.queue import RunQueue
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.rounds import aim_missed, asked_next
from irpmd_rig.acquisition.runs import Run, entered_at, first_incomplete
from irpmd_rig.acquisition.safety import Safety
from irpmd_rig.acquisition.sequencer import PROMPT_LIMIT_S, Sequencer, Surroundings
from irpmd_rig.processing import ProcessedRun, Progress, Worker
from irpmd_rig.processing.compensation import levels_of
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.recipes.plan import Plan, Prompt
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.library import Library
from irpmd_rig.store.states import Reason, RunState

# How often it looks whether a run may start, beside being woken.
LOOK_S = 0.25
# A run that was told to end does so by itself within this; then its instruments are stopped under it.
OBEY_S = 1.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Workplace:
    """What runs are carried out with.

    Attributes
    ----------
    rig, safety, hands, zeros
        The instruments, and what is known and wanted of them.
    book, queue, library, worker
        Runs, their order, what they may use, and who computes them.
    may_start
        Whether nothing outside the queue is in the way: no lease, no latched stop.
    check_space
        Refuses a run that would not fit on the disk.
    prompt_limit_s
        How long a person is waited for.
    """

    rig: Rig
    safety: Safety
    hands: Hands
    zeros: Zeros
    book: RunBook
    queue: RunQueue
    library: Library
    worker: Worker
    may_start: Callable[[], bool]
    check_space: Callable[[Run], None]
    prompt_limit_s: float = PROMPT_LIMIT_S


class Runner:
    """The thread that carries runs out.

    Parameters
    ----------
    place
        What it works with.
    """

    def __init__(self, place: Workplace) -> None:
        self._place = place
        self._changed = threading.Condition()
        self._closing = False
        self._active: Run | None = None
        self._thread = threading.Thread(target=self._work, name="runner", daemon=True)

    @property
    def active(self) -> Run | None:
        """The run under way."""
        with self._changed:
            return self._active

    def start(self) -> None:
        """Begin to take runs."""
        self._thread.start()

    def wake(self) -> None:
        """Look at the queue now."""
        with self._changed:
            self._changed.notify_all()

    def end_active(self, ending: Ending, limit_s: float) -> bool:
        """Let the run under way end; returns whether it has, within `limit_s`.

        It is asked first; then its instruments are stopped under it, and its computing process is killed.
        """
        run = self.active
        if run is None:
            return True
        run.conduct.end(ending)
        self._place.worker.cancel()
        if self._ended(run, min(OBEY_S, limit_s)):
            return True
        self._place.safety.make_safe()
        self._place.worker.cancel()
        return self._ended(run, max(0.0, limit_s - OBEY_S))

    def close(self, limit_s: float) -> None:
        """Interrupt the run under way, and end the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self.end_active(
            Ending(RunState.INTERRUPTED, Reason.DAEMON_RESTARTED, "the daemon ended: retry the run"), limit_s
        )
        if self._thread.ident is not None:
            self._thread.join(limit_s)

    def _ended(self, run: Run, limit_s: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: self._active is not run, limit_s)

    # --- the thread

    def _work(self) -> None:
        while self._waited():
            try:
                run = self._next()
                if run is not None:
                    self._carry_out(run)
            except (StoreError, DocumentError) as error:
                self._place.queue.hold(f"a run cannot be read or written: {error}")
                _log.error("a run cannot be read or written: %s", error)
            # The thread must not end: nobody else takes runs.
            except Exception as error:
                self._place.queue.hold(f"a fault of the program: {type(error).__name__}: {error}; see its log")
                _log.exception("the runner goes on after a fault of the program")

    def _waited(self) -> bool:
        with self._changed:
            if not self._closing:
                self._changed.wait(LOOK_S)
            return not self._closing

    def _next(self) -> Run | None:
        place = self._place
        run_id = place.queue.first()
        if run_id is None or place.queue.why_held or not place.may_start():
            return None
        run = place.book.live(run_id)
        if needs_person(run.plan, place.rig) and not place.queue.leave_is_fresh:
            place.queue.hold(f"run {run_id} needs an operator: resume the queue when there is one")
            return None
        return run

    def _carry_out(self, run: Run) -> None:
        place = self._place
        with self._changed:
            self._active = run
        try:
            with place.hands.of_run(run.id):
                place.queue.remove(run.id)
                # Somebody may have aborted it while the instruments were waited for.
                if run.state is RunState.QUEUED:
                    place.queue.leave_used()
                    self._to_the_end(run)
        finally:
            with self._changed:
                self._active = None
                self._changed.notify_all()

    def _to_the_end(self, run: Run) -> None:
        place = self._place
        try:
            run.conduct.check()
            run.become(RunState.PREPARING)
            computed = self._acquire(run)
            run.conduct.check()
            run.become(RunState.RECONSTRUCTING)
            missed = aim_missed(computed or self._compute(run))
            if missed is not None:
                raise RunEnded(missed)
            run.become(RunState.SUCCEEDED)
            place.book.forget(run.id)
        # Whatever it was, the run has ended, and says why.
        except BaseException as error:
            ending = run.conduct.ending or ending_of(error)
            _log.warning("run %s ends: %s", run.id, ending.detail, exc_info=not isinstance(error, InstrumentError))
            if isinstance(error, InstrumentError):
                place.rig.note(error)
            place.queue.hold(f"run {run.id} ended: {ending.state}, {ending.reason}")
            place.safety.make_safe()
            self._finish_frames(run)
            if not run.state.final:
                run.end(ending)
        else:
            self._finish_frames(run)

    def _finish_frames(self, run: Run) -> None:
        try:
            run.folder.close()
        except StoreError as error:
            _log.warning("run %s: %s", run.id, error)

    # --- one run

    def _acquire(self, run: Run) -> ProcessedRun | None:
        """Take what is missing of the run's frames; the rig is safe afterwards.

        Returns what was computed of all of them, if that decided that there are no more.
        """
        place = self._place
        place.safety.check()
        run.folder.results.clear()
        first = entered_at(run.plan, first_incomplete(run.plan, run.folder.manifest()))
        stations = len(run.plan.stations)
        if run.plan.steered:
            # What is asked between its rounds may have been done in part: they are taken in one go.
            first = 0
        if first < stations:
            check_start(place.rig, run.plan)
            place.check_space(run)
            settle_uses(place.rig, run.folder, place.library)
            # Only looked up, so that nothing moves for a run that cannot be shown.
            levels_of(place.library, run.recipe.compensation)
            self._ready_axes(run)
            if not self._zeros_hold(run):
                first = 0
            run.zeros = place.zeros.now()
            run.folder.supersede(entry for entry in run.folder.manifest() if entry.station >= first)
        run.become(RunState.RUNNING)
        if first == stations:
            run.begin_at(first)
            return None
        computed: ProcessedRun | None = None

        def decide() -> Prompt | None:
            nonlocal computed
            computed = self._compute(run)
            return asked_next(computed)

        surroundings = Surroundings(
            photographer=lambda: self._photographer(run),
            at_ease=place.hands.at_ease,
            station_done=lambda station: place.worker.decode(run.folder.path, station),
            decide=decide,
            prompt_limit_s=place.prompt_limit_s,
        )
        Sequencer(place.rig, run, surroundings).execute(first)
        for name, report in place.safety.make_safe().items():
            if report.error is not None and name in place.safety.concerns:
                raise DeviceFault(name, f"it could not be made safe: {report.error}", "look at it")
        return computed

    def _ready_axes(self, run: Run) -> None:
        place = self._place
        for name in sorted(axes_of(run.plan)):
            run.conduct.check()
            stage = place.rig.stage(name)
            if not has_zero(stage):
                run.doing(f"{name} finds its zero")
                if place.rig.operator is not None and not stage.capabilities().can_home:
                    # Nothing can be asked of it: what an earlier program may have begun is waited for.
                    run.conduct.sleep(stage.stop().ends_in_s)
                place.zeros.given(name)
                place.rig.find_zero(name)
            # A move that was stopped is still the last one: its failure is told here, and not taken for a new one.
            with suppress(MotionFailed, LimitReached):
                stage.wait()

    def _zeros_hold(self, run: Run) -> bool:
        """Whether frames of an earlier attempt may be kept: no axis of the plan has another zero, or an estimate."""
        axes = axes_of(run.plan)
        now, then = self._place.zeros.now(), run.zeros
        return not axes or (
            then is not None
            and all(now.get(name) == then.get(name) for name in axes)
            and all(self._place.rig.stage(name).capabilities().reads_position for name in axes)
        )

    def _photographer(self, run: Run) -> Photographer:
        place, recipe, file = self._place, run.recipe, self._place.rig.file
        light = recipe.light
        settings = CaptureSettings(
            led=Led(light.led) if light is not None else file.light.led,
            intensity=light.intensity if light is not None else file.light.intensity,
            pixel_format=recipe.pixel_format,
            levels=levels_of(place.library, recipe.compensation),
            retries=recipe.retries,
        )
        conduct: Conduct = run.conduct
        return Photographer(place.rig, recipe.trigger or file.trigger, settings, conduct.ended)

    def _compute(self, run: Run) -> ProcessedRun:
        def announce(progress: Progress) -> None:
            run.conduct.check()
            run.doing(progress.text)

        return self._place.worker.process(run.folder.path, announce)


def needs_person(plan: Plan, rig: Rig) -> bool:
    """Whether a plan asks something that no program answers."""
    prompts = [station.prompt for station in plan.stations if station.prompt is not None]
    return any(rig.operator is None or prompt.scene is None for prompt in prompts)
