"""The states of a run, the one table of transitions between them, and why a run ended.

    queued -> preparing -> running <-> paused | waiting_for_operator
                           running -> reconstructing -> succeeded

Every state that is not final may also go to failed, aborted or interrupted; a retry takes those back to queued.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from types import MappingProxyType

from irpmd_rig.store.errors import TransitionRefused


class RunState(StrEnum):
    """Where a run is."""

    QUEUED = "queued"
    PREPARING = "preparing"
    RUNNING = "running"
    PAUSED = "paused"
    WAITING_FOR_OPERATOR = "waiting_for_operator"
    RECONSTRUCTING = "reconstructing"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    ABORTED = "aborted"
    INTERRUPTED = "interrupted"

    @property
    def final(self) -> bool:
        """Whether the run has ended."""
        return self in ENDED


class Reason(StrEnum):
    """Why a run ended badly: a closed list."""

    DEVICE_LOST = "device_lost"
    DEVICE_TIMEOUT = "device_timeout"
    DEVICE_FAULT = "device_fault"
    MOTION_FAILED = "motion_failed"
    LIMIT = "limit"
    FRAMES_LOST = "frames_lost"
    FRAME_QUALITY = "frame_quality"
    DISK_FULL = "disk_full"
    REFUSED = "refused"
    PROMPT_EXPIRED = "prompt_expired"
    STOPPED = "stopped"
    ABORTED_BY_USER = "aborted_by_user"
    DAEMON_RESTARTED = "daemon_restarted"
    RECONSTRUCTION_FAILED = "reconstruction_failed"


ENDED_BADLY = frozenset({RunState.FAILED, RunState.ABORTED, RunState.INTERRUPTED})
ENDED = ENDED_BADLY | {RunState.SUCCEEDED}

_FORWARD: dict[RunState, frozenset[RunState]] = {
    RunState.QUEUED: frozenset({RunState.PREPARING}),
    RunState.PREPARING: frozenset({RunState.RUNNING}),
    RunState.RUNNING: frozenset({RunState.PAUSED, RunState.WAITING_FOR_OPERATOR, RunState.RECONSTRUCTING}),
    RunState.PAUSED: frozenset({RunState.RUNNING}),
    RunState.WAITING_FOR_OPERATOR: frozenset({RunState.RUNNING}),
    RunState.RECONSTRUCTING: frozenset({RunState.SUCCEEDED}),
}

TRANSITIONS: MappingProxyType[RunState, frozenset[RunState]] = MappingProxyType(
    {state: ahead | ENDED_BADLY for state, ahead in _FORWARD.items()}
    | {RunState.SUCCEEDED: frozenset()}
    | {state: frozenset({RunState.QUEUED}) for state in ENDED_BADLY}
)


@dataclass(frozen=True, slots=True)
class Transition:
    """One line of `state.jsonl`.

    Attributes
    ----------
    state
        What the run is now.
    reason
        Why it ended badly; None in every other state.
    detail
        The same in words, for a person.
    attempt
        1, and one more after each retry.
    order
        Place in the queue (a number that only grows); None where it was never queued.
    key
        The client's idempotency key, if it gave one.
    time
        When, with time zone.
    """

    state: RunState
    reason: Reason | None = None
    detail: str = ""
    attempt: int = 1
    order: int | None = None
    key: str | None = None
    time: datetime | None = None

    def __post_init__(self) -> None:
        if (self.reason is not None) != (self.state in ENDED_BADLY):
            wanted = "needs a reason" if self.state in ENDED_BADLY else "has no reason"
            raise TransitionRefused(f"state {self.state} {wanted}, got {self.reason}")
        if self.attempt < 1:
            raise TransitionRefused(f"attempts count from 1, got {self.attempt}")
        if self.time is None:
            object.__setattr__(self, "time", datetime.now(UTC))


def check_transition(before: Transition | None, after: Transition) -> None:
    """Refuse a change that the table does not know.

    Parameters
    ----------
    before
        The last state; None for a new run.
    after
        The next one.

    Raises
    ------
    TransitionRefused
        If the table has no such change, or if the attempt does not grow by one at a retry and stay otherwise.
    """
    if before is None:
        if after.state is not RunState.QUEUED:
            raise TransitionRefused(f"a run begins as queued, not as {after.state}")
        return
    if after.state not in TRANSITIONS[before.state]:
        allowed = ", ".join(sorted(TRANSITIONS[before.state])) or "nothing: it has ended"
        raise TransitionRefused(f"a run that is {before.state} cannot become {after.state}, only {allowed}")
    attempt = before.attempt + (after.state is RunState.QUEUED)
    if after.attempt != attempt:
        raise TransitionRefused(f"{before.state} -> {after.state} belongs to attempt {attempt}, not {after.attempt}")
