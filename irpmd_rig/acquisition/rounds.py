"""What a run that is steered by its own results asks before its next round, and whether it reached its aim."""

from __future__ import annotations

from irpmd_rig.acquisition.conduct import Ending
from irpmd_rig.processing import ProcessedRun
from irpmd_rig.processing.align import ASK, LEFT
from irpmd_rig.recipes.plan import Prompt, Scene
from irpmd_rig.store.states import Reason, RunState


def asked_next(computed: ProcessedRun) -> Prompt | None:
    """Read what the operator is to do from what was computed of the rounds so far; None: no more rounds are needed."""
    summary = computed.summary
    text = summary.get(ASK)
    if not isinstance(text, str):
        return None
    about_x, about_y = (summary[f"turn_about_{axis}_deg"] for axis in ("x", "y"))
    assert isinstance(about_x, float)
    assert isinstance(about_y, float)
    return Prompt(text, Scene("mirror", turn_deg=(about_x, about_y)))


def aim_missed(computed: ProcessedRun) -> Ending | None:
    """How a run ends whose last round left something to do: nothing may go on as if it were done. None: it is."""
    left = computed.summary.get(LEFT)
    return Ending(RunState.FAILED, Reason.REFUSED, left) if isinstance(left, str) else None
