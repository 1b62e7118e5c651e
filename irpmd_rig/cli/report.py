"""Reports of run folders, written without a daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, say
from irpmd_rig.cli.folders import Root


@app.command()
def report(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Folders of runs, also hand-written.")],
    root: Root = None,
) -> None:
    """Write results/report.html of run folders again, and its figures as SVG; prints the page's path.

    The page is one file that needs nothing else. It shows what is in the folder: `reconstruct` computes that again.
    """
    from irpmd_rig.cli.given import library_for
    from irpmd_rig.report.run import REPORT, write_report
    from irpmd_rig.store import RunFolder

    for folder in folders:
        library = library_for(folder, {}, root)
        with RunFolder(folder.resolve()) as opened:
            write_report(opened, library)
            say(str(opened.results.path(REPORT)))
