"""Faults that can be injected into a simulated camera while it runs, from any thread."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

from sims.camera.wire import Refusal, Status

WARM_C = 41.0
"""Temperature of a camera in good order."""


@dataclass(frozen=True, slots=True)
class FrameFault:
    """What is wrong with a frame: lost on its way, cut to a share of its bytes, or late."""

    dropped: bool = False
    share: float = 1.0
    late_s: float = 0.0


class CameraFaults:
    """Faults of one camera; those that count down end by themselves.

    Parameters
    ----------
    unplug, replug : callable
        What pulls and puts the camera's plug.
    """

    def __init__(self, unplug: Callable[[], None], replug: Callable[[], None]):
        self._lock = Lock()
        self._unplug, self._replug = unplug, replug
        self._next: dict[str, int] = {"drop": 0, "incomplete": 0, "late": 0, "trigger": 0}
        self._share, self._late_s = 0.5, 0.0
        self._refused: dict[tuple[str, str], int] = {}
        self._temperature_c = WARM_C
        self._answer_s = 0.0
        self._hanging = False

    def drop_next(self, frames: int = 1) -> None:
        """Lose the next `frames` frames between camera and computer: their frame ids are missing."""
        self._count("drop", frames)

    def incomplete_next(self, frames: int = 1, share: float = 0.5) -> None:
        """Deliver only the first `share` of the bytes of the next `frames` frames."""
        with self._lock:
            self._share = share
        self._count("incomplete", frames)

    def late_next(self, frames: int = 1, seconds: float = 1.0) -> None:
        """Deliver the next `frames` frames `seconds` (of the clock) after their time."""
        with self._lock:
            self._late_s = seconds
        self._count("late", frames)

    def miss_triggers(self, triggers: int = 1) -> None:
        """Do not see the next `triggers` triggers."""
        self._count("trigger", triggers)

    def fail_reads(self, node: str, times: int = 1) -> None:
        """Answer the next `times` reads of a node, by its name, with an error."""
        with self._lock:
            self._refused["read", node] = times

    def fail_writes(self, node: str, times: int = 1) -> None:
        """Answer the next `times` writes to a node, by its name, with an error, and change nothing."""
        with self._lock:
            self._refused["write", node] = times

    def answer_after(self, seconds: float) -> None:
        """Answer each access to a node only after that many real seconds; 0 ends it."""
        self._answer_s = seconds

    def overheat(self, temperature_c: float = 85.0) -> None:
        """Show this temperature."""
        self._temperature_c = temperature_c

    def cool(self) -> None:
        """Show the usual temperature again."""
        self._temperature_c = WARM_C

    def hang(self) -> None:
        """Expose and deliver nothing, triggered or not, while the nodes go on answering."""
        self._hanging = True

    def recover(self) -> None:
        """End `hang`."""
        self._hanging = False

    def unplug(self) -> None:
        """Pull the plug: connections break, no camera is listed, and all settings are lost."""
        self._unplug()

    def replug(self) -> None:
        """Put the plug back: the camera is listed again, as after power-up; one that is in stays as it is."""
        self._replug()

    @property
    def temperature_c(self) -> float:
        """Temperature to show."""
        return self._temperature_c

    @property
    def answer_s(self) -> float:
        """Real seconds before an answer."""
        return self._answer_s

    @property
    def hanging(self) -> bool:
        """Whether the acquisition hangs."""
        return self._hanging

    def take_frame(self) -> FrameFault:
        """Take what befalls the next frame."""
        with self._lock:
            dropped = self._take("drop")
            share = self._share if self._take("incomplete") else 1.0
            late_s = self._late_s if self._take("late") else 0.0
        return FrameFault(dropped, share, late_s)

    def take_trigger(self) -> bool:
        """Whether the next trigger is missed."""
        with self._lock:
            return self._take("trigger")

    def check(self, access: str, node: str) -> None:
        """Raise Refusal where this `access` ("read" or "write") to `node` is to fail."""
        with self._lock:
            left = self._refused.get((access, node), 0)
            if left > 0:
                self._refused[access, node] = left - 1
        if left > 0:
            raise Refusal(Status.IO, f"injected: {access} of {node} fails")

    def _count(self, fault: str, times: int) -> None:
        with self._lock:
            self._next[fault] = times

    def _take(self, fault: str) -> bool:
        left = self._next[fault]
        self._next[fault] = max(0, left - 1)
        return left > 0
