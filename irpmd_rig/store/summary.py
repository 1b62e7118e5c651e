"""What a list of runs shows of one."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from irpmd_rig.store.errors import RunFolderError
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Reason, RunState, Transition


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a list of runs shows of one.

    Attributes
    ----------
    id, kind, name, operator, sample, created
        As in `run.yaml`; ``kind`` is empty if the folder cannot be read, and ``detail`` says why.
    state, reason, detail, attempt, order, key, changed
        The last line of `state.jsonl`; state None if there is none.
    state_bytes
        Length of `state.jsonl` when it was read: it only grows, so an equal length is the same content.
    """

    id: str
    kind: str
    name: str
    operator: str
    sample: str
    created: datetime | None
    state: RunState | None
    reason: Reason | None
    detail: str
    attempt: int
    order: int | None
    key: str | None
    changed: datetime | None
    state_bytes: int


def summarise(folder: RunFolder) -> RunSummary:
    """Read a run's summary from its folder; a damaged folder has one too."""
    # Taken before the content: a line that is added meanwhile makes the summary old, never wrongly new.
    state_bytes = folder.state_bytes()
    record, damage = _record(folder)
    try:
        last = folder.state()
    except RunFolderError as error:
        last, damage = None, damage or str(error)
    shown = last or Transition(RunState.QUEUED)
    return RunSummary(
        id=folder.id,
        kind=record.kind if record else "",
        name=record.name if record else "",
        operator=record.operator if record else "",
        sample=record.sample if record else "",
        created=record.created if record else None,
        state=last.state if last else None,
        reason=shown.reason,
        detail=damage or shown.detail,
        attempt=shown.attempt,
        order=shown.order,
        key=shown.key,
        changed=last.time if last else None,
        state_bytes=state_bytes,
    )


def _record(folder: RunFolder) -> tuple[RunRecord | None, str]:
    try:
        return folder.record(), ""
    except RunFolderError as error:
        return None, str(error)
