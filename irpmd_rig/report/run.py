"""The report of a run: one page and its figures, written beside the other results."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from irpmd_rig.report import calibrations, preparation
from irpmd_rig.report.checks import ended_badly
from irpmd_rig.report.content import Page, Section, Verdict
from irpmd_rig.report.html import drawings, render
from irpmd_rig.report.measurement import measurement
from irpmd_rig.report.reading import Run, read_run
from irpmd_rig.report.taking import origin_section
from irpmd_rig.report.wording import MISSING, moment
from irpmd_rig.store.errors import RunFolderError
from irpmd_rig.store.library import Library
from irpmd_rig.store.run_folder import RunFolder

REPORT = "report.html"

_KINDS: Mapping[str, Callable[[Run], tuple[Verdict, tuple[Section, ...]]]] = {
    "measure": measurement,
    "calibrate-camera": calibrations.camera,
    "calibrate-plate": calibrations.plate,
    "calibrate-geometry": calibrations.geometry,
    "reference": calibrations.reference,
    "align": preparation.align,
    "characterise": preparation.characterise,
}


def write_report(folder: RunFolder, library: Library | None = None) -> tuple[str, ...]:
    """Write `report.html`, which needs no other file, and each of its figures as SVG.

    Parameters
    ----------
    folder
        The run, also one that failed or was written by hand; what it has is shown.
    library
        Where the calibrations are that it used; the folders beside it by default.

    Returns
    -------
    tuple of str
        Names of the results that were written.

    Raises
    ------
    RunFolderError
        If the run cannot be read, or its results are damaged.
    DiskFull, WriteFailed
        If a file could not be written.
    """
    page = run_page(read_run(folder, library))
    drawn = drawings(page)
    for name, document in drawn.items():
        folder.results.write_text(f"{name}.svg", document)
    folder.results.write_text(REPORT, render(page, drawn))
    return (*(f"{name}.svg" for name in drawn), REPORT)


def run_page(run: Run) -> Page:
    """Everything that the report of a run says; raises RunFolderError if its results are damaged."""
    record = run.record
    describe = _KINDS.get(record.kind, calibrations.other)
    try:
        verdict, sections = (describe if run.content is not None else calibrations.other)(run)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise RunFolderError(
            f"{run.folder.path}: its results are not whole ({error!r}); reconstruct the run, then report on it"
        ) from error
    if run.content is None and record.kind in _KINDS:
        verdict = Verdict(None, "Nothing was computed of this run", "Its frames are shown as they are.")
    page = Page(
        title=record.name or f"{record.kind} {run.folder.id}",
        subtitle=" · ".join(
            part
            for part in (
                record.kind,
                run.folder.id,
                moment(record.created.isoformat() if record.created else ""),
                record.sample,
            )
            if part and part != MISSING
        ),
        verdict=ended_badly(run) or verdict,
        sections=sections,
    )
    origin = origin_section(run, [f"{picture.name}.svg" for picture in page.pictures])
    return Page(page.title, page.subtitle, page.verdict, (*sections, origin))
