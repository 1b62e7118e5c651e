"""Calibrations and a reference that are given as folders, before those of a store."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from irpmd_rig.processing import Refused
from irpmd_rig.store import (
    ACTIVE,
    CALIBRATIONS,
    REFERENCE,
    FileNotInRun,
    Library,
    NotUsable,
    RunFolder,
    RunFolderError,
    Store,
)
from irpmd_rig.store.results import CALIBRATION

_COMPUTE = "reconstruct it first, or give another folder"


class GivenRuns(Library):
    """What a run is computed with: what is given, and of a store what is not.

    Parameters
    ----------
    given
        Folders by kind; what they were made with is found beside them.
    root
        Folder of the store; None: there is none.
    """

    def __init__(self, given: dict[str, RunFolder], root: Path | None) -> None:
        self._given = given
        self._has_store = root is not None
        if root is not None:
            super().__init__(Store(root))

    def resolve(self, kind: str, wanted: str = ACTIVE) -> RunFolder:
        """The folder to use; raises NotUsable if there is none."""
        found = self._given.get(kind)
        if found is not None:
            return found
        if not self._has_store:
            raise NotUsable(f"no {kind} is given, and no store: there is no folder data here")
        return super().resolve(kind, wanted)


def given_runs(calibrations: Sequence[Path], reference: Path | None) -> dict[str, RunFolder]:
    """Read which calibrations and which reference some folders stand for, and what these were made with.

    Raises
    ------
    Refused
        One of them is none, or has not been computed.
    """
    given: dict[str, RunFolder] = {}
    implied: dict[str, RunFolder] = {}
    for calibration in calibrations:
        _add(given, implied, calibration, CALIBRATIONS)
    if reference is not None:
        _add(given, implied, reference, (REFERENCE,))
    return implied | given


def library_for(folder: Path, given: dict[str, RunFolder], root: Path | None) -> Library:
    """Make the library for one run; where its run.yaml names others than are given, it names these from now on.

    Parameters
    ----------
    folder
        The run.
    given
        Of `given_runs`.
    root
        Folder of the store; None: the one that the run lies in, or ``data`` here.

    Raises
    ------
    RunFolderError
        The run cannot be read.
    """
    run = RunFolder(folder)
    uses = run.record().uses
    others = {kind: it.id for kind, it in given.items() if uses.get(kind, ACTIVE) not in (ACTIVE, it.id)}  # type: ignore[call-overload]
    if others:
        run.amend(uses={**uses, **others})
    places = (folder.resolve().parent, Path("data")) if root is None else ()
    # A store in which something was activated; any other folder is left alone.
    return GivenRuns(given, root or next((place for place in places if (place / "active.json").is_file()), None))


def _add(given: dict[str, RunFolder], implied: dict[str, RunFolder], path: Path, kinds: tuple[str, ...]) -> None:
    folder = RunFolder(path.resolve())
    try:
        kind = folder.record().kind
        uses = folder.results.read_json(CALIBRATION).get("uses", {})
    except (FileNotInRun, RunFolderError) as error:
        raise Refused(f"{path} cannot be used: {error}", _COMPUTE) from None
    if kind not in kinds:
        raise Refused(f"{path} is a {kind}, not a {' or '.join(kinds)}", "give another folder")
    given[kind] = folder
    for other, run_id in uses.items():
        beside = folder.path.parent / run_id
        if kind != REFERENCE and beside.is_dir():
            implied[other] = RunFolder(beside)
