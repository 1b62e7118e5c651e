"""The moment at which a stage's controller says that a motion has ended, before anything waits for it to settle."""

from __future__ import annotations

import time

from drivers.protocols import MotionFailed, Refused, Stage, StageCondition
from irpmd_rig.acquisition.conduct import Conduct

# A stage that is this near to its target, and does not move, has arrived; a controller that has not begun yet is not.
NEAR_MM = 0.1
LIMIT_S = 120.0
_POLL_S = 0.002


def check_away(stage: Stage, target_mm: float) -> None:
    """Refuse to wait for an arrival where nothing would move.

    Raises
    ------
    Refused
        The stage stands at its target already.
    """
    position = stage.state().position
    if position is not None and abs(position.position_mm - target_mm) <= NEAR_MM:
        raise Refused(
            stage.name,
            f"it stands at {target_mm:g} mm already: it cannot be seen to arrive there",
            f"begin more than {NEAR_MM:g} mm away from it",
        )


def await_arrival(stage: Stage, target_mm: float, conduct: Conduct) -> float:
    """Wait until a stage that moves has arrived; returns `time.monotonic` of when it was seen to have.

    Parameters
    ----------
    stage
        Whose motion has begun.
    target_mm
        Where to.
    conduct
        Looked at meanwhile.

    Raises
    ------
    MotionFailed
        It does not arrive.
    RunEnded
        Somebody wanted it.
    """
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        conduct.check()
        state = stage.state()
        now_s = time.monotonic()
        if state.condition is not StageCondition.MOVING and state.position is not None:
            if abs(state.position.position_mm - target_mm) <= NEAR_MM:
                return now_s
            if state.condition is not StageCondition.READY:
                break
        time.sleep(_POLL_S)
    raise MotionFailed(stage.name, f"it did not arrive at {target_mm:g} mm", "look at the stage, then retry the run")
