"""What a run that is steered by its own results asks before its next round."""

from __future__ import annotations

from irpmd_rig.processing import ProcessedRun
from irpmd_rig.processing.align import ASK
from irpmd_rig.recipes.plan import Prompt, Scene


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
