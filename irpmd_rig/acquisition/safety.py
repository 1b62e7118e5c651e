"""Everything stopped and dark: when a run ends, when somebody says stop, when the daemon starts and ends."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from drivers.protocols import InstrumentError, StopAnswer
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.status import StopReport

# Drivers end their own stop within a few seconds; what takes longer than this is reported as not told.
SAFE_LIMIT_S = 15.0

_log = logging.getLogger(__name__)
Result = TypeVar("Result")


class StopLatched(AcquisitionError):
    """Everything was stopped, and nobody has cleared that yet."""

    def __init__(self) -> None:
        super().__init__("everything was stopped", "see that it is safe to go on, then clear the stop")


class Overdue(Exception):
    """A call did not return within its bound; its thread is left to itself."""


class Safety:
    """Makes the rig safe, and keeps the latch of the emergency stop.

    Parameters
    ----------
    rig
        The instruments.
    events
        Where stops are announced.
    limit_s
        Bound of making safe.
    """

    def __init__(self, rig: Rig, events: EventLog, limit_s: float = SAFE_LIMIT_S) -> None:
        self._rig = rig
        self._events = events
        self._limit_s = limit_s
        self._lock = threading.Lock()
        self._latched = False
        self._concerns: dict[str, str] = {}

    @property
    def latched(self) -> bool:
        """Whether everything was stopped and nothing may start."""
        with self._lock:
            return self._latched

    @property
    def concerns(self) -> dict[str, str]:
        """Instruments that were reached and could not be made safe, and why: somebody has to look at them."""
        with self._lock:
            return dict(self._concerns)

    def check(self) -> None:
        """Raise StopLatched while the stop is latched."""
        if self.latched:
            raise StopLatched

    def latch(self) -> None:
        """Let nothing start from now on."""
        with self._lock:
            self._latched = True

    def clear(self) -> None:
        """Allow starting again."""
        with self._lock:
            self._latched = False
        self._events.announce("stop", latched=False)

    def make_safe(self) -> dict[str, StopReport]:
        """Turn the LED off, show nothing, stop stages and camera; never raises, ends within the bound.

        Returns
        -------
        dict
            What was achieved, for every instrument of the rig.
        """
        try:
            answers: Mapping[str, StopAnswer | InstrumentError] = bounded(self._rig.make_safe, self._limit_s)
        except Overdue:
            late = f"it did not answer within {self._limit_s:g} s: look at it, and switch it off by hand"
            reports = {name: StopReport(stopped=False, error=late) for name in self._rig.devices}
            reached = set(reports)
        else:
            reports = {name: self._report(name, answers.get(name)) for name in self._rig.devices}
            reached = set(answers)
        concerns = {name: report.error for name, report in reports.items() if report.error and name in reached}
        with self._lock:
            before, self._concerns = self._concerns, concerns
        for name, error in concerns.items():
            # Once: it is tried again for as long as it takes.
            if name not in before:
                _log.error("%s could not be made safe: %s", name, error)
        return reports

    def _report(self, name: str, answer: StopAnswer | InstrumentError | None) -> StopReport:
        if isinstance(answer, StopAnswer):
            return StopReport(answer.stopped, answer.ends_in_s)
        if answer is not None:
            return StopReport(stopped=False, error=f"{answer.what} ({answer.remedy})")
        state = self._rig.devices[name]
        return StopReport(stopped=False, error=f"it was not reached: it is {state.state} {state.detail}".strip())


class _Call(Generic[Result]):
    """A call in a thread of its own."""

    def __init__(self, call: Callable[[], Result]) -> None:
        self._call = call
        self.result: list[Result] = []
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result.append(self._call())
        except BaseException as error:
            self.error = error


def bounded(call: Callable[[], Result], limit_s: float) -> Result:
    """Return what a call returns, or raise what it raises; raises Overdue if it does neither within `limit_s`."""
    made = _Call(call)
    thread = threading.Thread(target=made.run, name="bounded call", daemon=True)
    thread.start()
    thread.join(limit_s)
    if thread.is_alive():
        raise Overdue
    if made.error is not None:
        raise made.error
    return made.result[0]
