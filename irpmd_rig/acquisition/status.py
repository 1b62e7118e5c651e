"""What the daemon tells about rig, queue and runs: frozen values."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from drivers.protocols import Position, StageCondition, TravelLimits
from irpmd_rig.acquisition.lease import Holder
from irpmd_rig.acquisition.rig import DeviceState
from irpmd_rig.recipes.document import Problem
from irpmd_rig.recipes.estimate import Estimate
from irpmd_rig.store.states import Reason, RunState


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """Where an axis is.

    Attributes
    ----------
    condition
        What it is doing.
    position
        Measured or estimated, as it says; None: the axis has no zero.
    target_mm
        Where the present or last move goes.
    limits
        Soft limits; None: the axis is not open.
    """

    condition: StageCondition
    position: Position | None
    target_mm: float | None
    limits: TravelLimits | None


@dataclass(frozen=True, slots=True)
class RigStatus:
    """The rig at one moment.

    Attributes
    ----------
    name, simulated
        As the rig file says.
    devices
        Every instrument by its name in the rig file.
    axes
        Every stage by its name.
    lease
        Who controls the rig by hand; None: nobody.
    active_run
        The run that holds the rig; None: none does.
    stop_latched
        Everything was stopped, and nothing starts until that is cleared.
    can_start
        Whether a run would begin now.
    reasons
        Every reason why not, each with what to do.
    free_bytes
        Room on the disk of the store.
    time_s
        When the instruments were asked, in seconds since 1970.
    """

    name: str
    simulated: bool
    devices: dict[str, DeviceState]
    axes: dict[str, AxisStatus]
    lease: Holder | None
    active_run: str | None
    stop_latched: bool
    can_start: bool
    reasons: tuple[str, ...]
    free_bytes: int
    time_s: float


@dataclass(frozen=True, slots=True)
class StopReport:
    """What stopping one instrument achieved.

    Attributes
    ----------
    stopped
        True: nothing of it moves, shines or exposes.
    ends_in_s
        Where software cannot stop it: seconds until it has ended by itself.
    error
        Where it could not be told, and nobody knows: what happened, what to do.
    """

    stopped: bool
    ends_in_s: float = 0.0
    error: str | None = None


@dataclass(frozen=True, slots=True)
class QueueStatus:
    """The queue.

    Attributes
    ----------
    held
        True: no run starts by itself.
    why
        Why it is held; empty when it is not.
    waiting
        Runs in their order.
    active_run
        The run under way.
    """

    held: bool
    why: str
    waiting: tuple[str, ...]
    active_run: str | None


@dataclass(frozen=True, slots=True)
class Validation:
    """What a recipe would do, and everything that is wrong with it; nothing was run.

    Attributes
    ----------
    problems
        With file, line and column; empty: it may run.
    warnings
        What would be refused if it ran now, and may have changed by the time it runs: calibration, reference, disk.
    kind, name
        None where the recipe cannot be read.
    estimate
        Bytes, seconds and motion; None where the recipe cannot be read.
    stations
        One line for each station.
    """

    problems: tuple[Problem, ...]
    warnings: tuple[str, ...] = ()
    kind: str | None = None
    name: str | None = None
    estimate: Estimate | None = None
    stations: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the recipe may run."""
        return not self.problems


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is.

    Attributes
    ----------
    stations_done, stations, frames_done, frames
        Of this attempt; what an earlier one left complete counts as done.
    doing
        What is going on, in words.
    """

    stations_done: int
    stations: int
    frames_done: int
    frames: int
    doing: str = ""


@dataclass(frozen=True, slots=True)
class PendingPrompt:
    """A question to the operator.

    Attributes
    ----------
    id
        Number of the prompt in the run; an answer may name it.
    text
        What to do.
    expires_s
        Until when it waits, in seconds since 1970: after that the run fails.
    """

    id: int
    text: str
    expires_s: float


@dataclass(frozen=True, slots=True)
class RunStatus:
    """A run at one moment.

    Attributes
    ----------
    id, kind, name
        The id is the server's; kind and name are the recipe's.
    state
        Where it is; None: a folder that was put there by hand.
    reason, detail
        Why it ended badly, from the closed list and in words.
    attempt
        1, and one more after each retry.
    created, changed
        When it was submitted, and when it came into its state.
    progress
        None before it first began under this daemon, and for runs of an earlier one.
    place
        Place in the queue, from 0; None: it does not wait.
    prompt
        What the operator is asked; None: nothing.
    asked
        ``"pause"`` or ``"abort"``: wanted, and not obeyed yet.
    estimate
        What it takes.
    frames
        Frames on disk that count; None in a list of runs.
    results
        Names of its results, once it has ended; empty in a list of runs.
    """

    id: str
    kind: str
    name: str
    state: RunState | None
    reason: Reason | None
    detail: str
    attempt: int
    created: datetime | None
    changed: datetime | None
    progress: Progress | None = None
    place: int | None = None
    prompt: PendingPrompt | None = None
    asked: str | None = None
    estimate: Estimate | None = None
    frames: int | None = None
    results: tuple[str, ...] = ()
