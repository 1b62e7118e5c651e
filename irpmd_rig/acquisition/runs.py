"""One run as the daemon sees it: its plan, its state (always written before it is told), and how far it is."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime

from irpmd_rig.acquisition.conduct import Conduct, Ending
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.status import PendingPrompt, Progress, RunStatus
from irpmd_rig.recipes.estimate import Estimate
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.plan import Plan, Station
from irpmd_rig.store.entries import ManifestEntry
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import RunState, Transition, check_transition

_log = logging.getLogger(__name__)
FrameKey = tuple[str, str, str, int | None, int | None, int | None]


def expected_frames(station: Station) -> Counter[FrameKey]:
    """What frames a station has when it is complete: label, role, orientation, set, step, view."""
    wanted: Counter[FrameKey] = Counter()
    for shot in station.shots:
        if shot.role == "fringes":
            wanted.update(
                (shot.label, shot.role, shot.orientation, number, step, shot.view)
                for number in range(len(shot.counts))
                for step in range(shot.steps)
            )
        else:
            wanted[(shot.label, shot.role, "x", None, None, shot.view)] += shot.frames
    return wanted


def complete_stations(plan: Plan, entries: Iterable[ManifestEntry]) -> frozenset[int]:
    """Stations of which every frame, and no frame too many, is in the manifest."""
    found: dict[int, Counter[FrameKey]] = {}
    for entry in entries:
        key = (entry.label, entry.role, entry.orientation, entry.set, entry.step, entry.view)
        found.setdefault(entry.station, Counter())[key] += 1
    return frozenset(
        station.index for station in plan.stations if found.get(station.index, Counter()) == expected_frames(station)
    )


def first_incomplete(plan: Plan, entries: Iterable[ManifestEntry]) -> int:
    """Return the station at which a run goes on; the number of stations when all are complete."""
    done = complete_stations(plan, entries)
    return next((station.index for station in plan.stations if station.index not in done), len(plan.stations))


def arriving(station: Station) -> bool:
    """Whether its frames are taken while the stage comes to rest."""
    return any(shot.role == "series" for shot in station.shots)


def entered_at(plan: Plan, first: int) -> int:
    """Return where to begin so that `first` is taken as planned: where the stage is to arrive, it has to come from."""
    while 0 < first < len(plan.stations) and arriving(plan.stations[first]):
        first -= 1
    return first


class Run:
    """A run that waits, is under way, or ended under this daemon; safe to use from any thread.

    Parameters
    ----------
    folder
        Where it is kept.
    recipe, plan, estimate
        What it does.
    events
        Where changes are announced.
    """

    def __init__(self, folder: RunFolder, recipe: Recipe, plan: Plan, estimate: Estimate, events: EventLog) -> None:
        last = folder.state()
        assert last is not None, "a run of the store has a state"
        self.folder = folder
        self.recipe = recipe
        self.plan = plan
        self.estimate = estimate
        self.conduct = Conduct()
        self._events = events
        self._lock = threading.RLock()
        self._last = last
        self._unsaved: Transition | None = None
        self._created = folder.record().created or datetime.now(UTC)
        self._progress: Progress | None = None
        self._prompt: PendingPrompt | None = None
        # Which zero each axis had when this run's frames were taken; known only to the daemon that took them.
        self.zeros: dict[str, int] | None = None

    @property
    def id(self) -> str:
        """The run's id."""
        return self.folder.id

    @property
    def state(self) -> RunState:
        """Where it is."""
        with self._lock:
            return self._last.state

    @property
    def attempt(self) -> int:
        """1, and one more after each retry."""
        with self._lock:
            return self._last.attempt

    @property
    def order(self) -> int | None:
        """Place in the queue."""
        with self._lock:
            return self._last.order

    # --- state

    def become(self, state: RunState) -> None:
        """Change to a state in which the run goes on, or has succeeded.

        Raises
        ------
        TransitionRefused
            The transition table does not know it.
        DiskFull, WriteFailed
            It could not be written: the state is the old one.
        """
        with self._lock:
            after = replace(self._last, state=state, reason=None, detail="", time=datetime.now(UTC))
            self.folder.append_state(after)
            self._now(after)

    def requeue(self, order: int) -> None:
        """Reopen the run for another attempt; raises as `become`."""
        with self._lock:
            if self._unsaved is not None:
                self.folder.append_state(self._unsaved)
                self._unsaved = None
            last = self._last
            after = Transition(RunState.QUEUED, attempt=last.attempt + 1, order=order, key=last.key)
            self.folder.append_state(after)
            self.conduct = Conduct()
            self._progress = self._prompt = None
            self._now(after)

    def end(self, ending: Ending) -> None:
        """Let the run have ended badly, also where the disk does not take it: it is written as soon as it does."""
        with self._lock:
            last = self._last
            after = Transition(
                ending.state, ending.reason, ending.detail, attempt=last.attempt, order=last.order, key=last.key
            )
            check_transition(last, after)
            try:
                self.folder.append_state(after)
            except StoreError as error:
                _log.error("run %s: its end (%s) is not on disk yet: %s", self.id, ending.reason, error)
                self._unsaved = after
            self._prompt = None
            self._now(after)

    def save(self) -> None:
        """Write the end of the run where the disk refused it before; may be called at any time."""
        with self._lock:
            if self._unsaved is None:
                return
            try:
                self.folder.append_state(self._unsaved)
            except StoreError:
                return
            self._unsaved = None

    def _now(self, last: Transition) -> None:
        self._last = last
        if last.state.final:
            _log.info("run %s: %s %s %s", self.id, last.state, last.reason or "", last.detail)
        self._events.announce(
            "state", self.id, state=last.state, reason=last.reason, detail=last.detail, attempt=last.attempt
        )

    # --- progress

    def begin_at(self, first: int) -> None:
        """Set the progress to the beginning of a station."""
        stations = self.plan.stations
        done = sum(station.frames for station in stations[:first])
        self._set(Progress(first, len(stations), done, self.plan.frames))

    def doing(self, what: str) -> None:
        """Tell what is going on."""
        with self._lock:
            if self._progress is not None:
                self._set(replace(self._progress, doing=what))

    def frames_done(self, frames: int) -> None:
        """Set the number of frames of complete stations and of the present one."""
        with self._lock:
            if self._progress is not None:
                self._set(replace(self._progress, frames_done=frames))

    def stations_done(self, stations: int) -> None:
        """Set the number of stations that are complete."""
        with self._lock:
            if self._progress is not None:
                self._set(replace(self._progress, stations_done=stations))

    def _set(self, progress: Progress) -> None:
        with self._lock:
            if progress == self._progress:
                return
            self._progress = progress
        self._events.announce(
            "progress",
            self.id,
            stations_done=progress.stations_done,
            stations=progress.stations,
            frames_done=progress.frames_done,
            frames=progress.frames,
            doing=progress.doing,
        )

    # --- prompts

    def ask(self, number: int, text: str, limit_s: float) -> None:
        """Put a question to the operator."""
        prompt = PendingPrompt(number, text, time.time() + limit_s)
        self.conduct.ask(number)
        with self._lock:
            self._prompt = prompt
        self._events.announce("prompt", self.id, prompt=number, text=text, expires_s=prompt.expires_s)

    def asked_no_more(self) -> None:
        """Take the question back, answered or not."""
        with self._lock:
            self._prompt = None

    # --- what others are told

    def status(self) -> RunStatus:
        """Tell everything about the run."""
        with self._lock:
            last, progress, prompt = self._last, self._progress, self._prompt
            asked = None if last.state.final else self.conduct.asked
        if asked == "pause" and last.state is RunState.PAUSED:
            asked = None
        return RunStatus(
            id=self.id,
            kind=self.recipe.kind,
            name=self.recipe.name,
            state=last.state,
            reason=last.reason,
            detail=last.detail,
            attempt=last.attempt,
            created=self._created,
            changed=last.time or self._created,
            progress=progress,
            prompt=prompt,
            asked=asked,
            estimate=self.estimate,
            results=self.folder.results.names() if last.state.final else (),
        )
