"""How the results of a routine that prepares the rig are written: figures, and the same in plain words."""

from __future__ import annotations

from irpmd_rig.processing.archive import Content
from irpmd_rig.processing.job import Job
from irpmd_rig.store.results import RESULT


def write_findings(job: Job, size_px: tuple[int, int], words: str, content: Content) -> None:
    """Write `result.json` in place of what was computed before."""
    what = {"what": job.record.recipe["what"]} if "what" in job.record.recipe else {}
    job.begin_results()
    job.folder.results.write_json(RESULT, {**job.header(size_px), **what, "words": words, **content})
    job.wrote(RESULT)
