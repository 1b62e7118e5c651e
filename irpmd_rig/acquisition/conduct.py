"""What people want of the run under way: to pause it, to answer it, to end it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from irpmd_rig.store.states import Reason, RunState


@dataclass(frozen=True, slots=True)
class Ending:
    """How a run ends badly: the state, the reason from the closed list, and the same in words."""

    state: RunState
    reason: Reason
    detail: str


class RunEnded(Exception):
    """Raised inside a run that is to end."""

    def __init__(self, ending: Ending) -> None:
        super().__init__(ending)
        self.ending = ending

    def __str__(self) -> str:
        return self.ending.detail


class Conduct:
    """Wishes for one attempt of a run, from any thread; the sequencer looks at them between any two steps.

    Attributes
    ----------
    ended : threading.Event
        Set once the run is to end: for waits that look at an event.
    """

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._changed = threading.Condition()
        self._ending: Ending | None = None
        self._pause = False
        self._prompt: int | None = None
        self._answer: str | None = None

    # --- wishes, from any thread

    def end(self, ending: Ending) -> None:
        """Let the run end; the first wish counts."""
        with self._changed:
            if self._ending is None:
                self._ending = ending
                self.ended.set()
            self._changed.notify_all()

    def pause(self) -> None:
        """Let the run pause at its next step."""
        with self._changed:
            self._pause = True

    def resume(self) -> None:
        """Let the run go on."""
        with self._changed:
            self._pause = False
            self._changed.notify_all()

    def answer(self, text: str, prompt: int | None = None) -> bool:
        """Answer the prompt that waits (or only the one of the number `prompt`); False: none such waits."""
        with self._changed:
            if self._prompt is None or self._answer is not None or prompt not in (None, self._prompt):
                return False
            self._answer = text
            self._changed.notify_all()
            return True

    @property
    def ending(self) -> Ending | None:
        """How it was told to end; None: it was not."""
        with self._changed:
            return self._ending

    @property
    def asked(self) -> str | None:
        """What is wanted: ``"abort"``, ``"pause"`` or nothing."""
        with self._changed:
            return "abort" if self._ending else "pause" if self._pause else None

    # --- for the sequencer

    def check(self) -> None:
        """Raise RunEnded if the run is to end."""
        ending = self.ending
        if ending is not None:
            raise RunEnded(ending)

    def sleep(self, duration_s: float) -> None:
        """Wait; raises RunEnded as soon as the run is to end."""
        self._wait(lambda: False, duration_s)

    def pause_if_wanted(self, paused: Callable[[], None], resumed: Callable[[], None]) -> None:
        """Wait while a pause is wanted, calling `paused` before and `resumed` after; raises as `check`."""
        self.check()
        with self._changed:
            wanted = self._pause
        if not wanted:
            return
        paused()
        self._wait(lambda: not self._pause, None)
        resumed()

    def ask(self, prompt: int) -> None:
        """Accept answers to the prompt of this number from now on."""
        with self._changed:
            self._prompt, self._answer = prompt, None

    def await_answer(self, timeout_s: float) -> str | None:
        """Wait for the answer to the prompt that was asked; None: none came in time. Raises as `check`."""
        try:
            self._wait(lambda: self._answer is not None, timeout_s)
            with self._changed:
                return self._answer
        finally:
            with self._changed:
                self._prompt = self._answer = None

    def _wait(self, over: Callable[[], bool], timeout_s: float | None) -> None:
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while self._ending is None and not over():
                left_s = None if deadline_s is None else deadline_s - time.monotonic()
                if left_s is not None and left_s <= 0.0:
                    return
                self._changed.wait(left_s)
        self.check()
