"""`irpmd-rig doctor`: what is there, what is missing, what mends it; and the walk through a first contact."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console

from irpmd_rig.acquisition.errors import SimulationError
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.doctor.asking import Asker, Read
from irpmd_rig.doctor.examine import examine
from irpmd_rig.doctor.report import Finding, Report, line
from irpmd_rig.doctor.verify import verify as walk
from irpmd_rig.recipes.document import DocumentError


def doctor(
    rig: str,
    *,
    verify: bool,
    as_json: bool,
    console: Console,
    record: Path | None = None,
    read: Read | None = None,
) -> int:
    """Look at every instrument of a rig, each for itself, and say what was found.

    Parameters
    ----------
    rig
        Path of a rig file, or name of a shipped one.
    verify
        Walk the person at the rig through the checks of a first contact, and write a record of it.
    as_json
        One JSON object instead of text.
    console
        Where it goes.
    record
        File of the record; None: a name made of rig and time, in the working folder.
    read
        Takes the answers; None: from the console.

    Returns
    -------
    int
        Exit status: 0 if all is in order, 1 if something was found.

    Raises
    ------
    FileNotFoundError
        There is no such rig file.
    OSError
        The record cannot be written.
    """
    try:
        rig_file = read_rig(rig, deep=False)
    except DocumentError as error:
        findings = tuple(
            Finding(f"{problem.file}:{problem.line}:{problem.column}: {problem.what}", problem.remedy)
            for problem in error.problems
        )
        return _told(Report(Path(rig).stem, rig, findings=findings), console, as_json=as_json)
    opened = Rig(rig_file)
    try:
        try:
            opened.open()
        except SimulationError as error:
            failed = Report(rig_file.name, rig_file.document.name, True, findings=(Finding(error.what, error.remedy),))
            return _told(failed, console, as_json=as_json)
        report = examine(opened)
        if not verify:
            return _told(report, console, as_json=as_json)
        report.print(console)
        made, path = walk(opened, report, Asker(console, read), record)
        if made.who:
            line(console, f"The record is in {path}.")
        return 0 if report.clean and made.passed else 1
    finally:
        opened.close()


def _told(report: Report, console: Console, *, as_json: bool) -> int:
    if as_json:
        values: dict[str, Any] = report.as_json()
        console.out(json.dumps(values), highlight=False)
    else:
        report.print(console)
    return 0 if report.clean else 1
