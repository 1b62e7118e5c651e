"""Calibrations and references: succeeded runs of these kinds, of which one of each kind is active."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from irpmd_rig.store.errors import NotUsable, RunFolderError, RunNotFound
from irpmd_rig.store.record import CALIBRATIONS, Kind, Optics
from irpmd_rig.store.results import CALIBRATION
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import RunState
from irpmd_rig.store.store import Store

ACTIVE = "active"
REFERENCE = "reference"


@dataclass(frozen=True, slots=True)
class LibraryItem:
    """A calibration or reference that measurements may use.

    Attributes
    ----------
    id, kind, name, created
        Of its run.
    active
        Whether a recipe that says ``active`` gets it.
    optics
        The camera that it holds for; None if the run does not say.
    positions_mm
        Stage positions at which it was taken.
    uses
        Kind to id of what it was made with.
    """

    id: str
    kind: str
    name: str
    created: datetime | None
    active: bool
    optics: Optics | None
    positions_mm: tuple[float, ...]
    uses: Mapping[Kind, str]

    def age_days(self, now: datetime | None = None) -> float | None:
        """Days since it was made; None if the run does not say when."""
        return None if self.created is None else ((now or datetime.now(UTC)) - self.created).total_seconds() / 86400


class Library:
    """The calibrations and references of a store.

    Parameters
    ----------
    store
        Where the runs are.
    """

    def __init__(self, store: Store) -> None:
        self._store = store

    def calibrations(self) -> tuple[LibraryItem, ...]:
        """Usable calibrations, newest first."""
        return self._items(CALIBRATIONS)

    def references(self) -> tuple[LibraryItem, ...]:
        """Usable references, newest first."""
        return self._items((REFERENCE,))

    def activate(self, run_id: str, kinds: Collection[str] = (*CALIBRATIONS, REFERENCE)) -> LibraryItem:
        """Make a calibration or reference the active one of its kind; it is on disk when this returns.

        Parameters
        ----------
        run_id
            Which.
        kinds
            What it may be.

        Raises
        ------
        RunNotFound
            If there is no such run.
        NotUsable
            If it has not succeeded, or is of another kind.
        """
        folder = self._usable(run_id, kinds)
        self._store.active.set(folder.record().kind, run_id)
        return _item(folder, active=True)

    def active(self, kind: str) -> RunFolder | None:
        """The active run of a kind; None if none was activated. Raises NotUsable if it cannot serve any more."""
        run_id = self._store.active.read().get(kind)
        try:
            return None if run_id is None else self._usable(run_id, (kind,))
        except RunNotFound as error:
            raise NotUsable(f"the active {kind} is gone ({error}): activate another one") from error

    def resolve(self, kind: str, wanted: str = ACTIVE) -> RunFolder:
        """The run that a recipe asks for.

        Parameters
        ----------
        kind
            calibrate-camera, calibrate-plate, calibrate-geometry or reference.
        wanted
            An id, or ``active``.

        Raises
        ------
        NotUsable
            If there is none, it has not succeeded, or it is of another kind.
        """
        if wanted == ACTIVE:
            folder = self.active(kind)
            if folder is None:
                raise NotUsable(f"no {kind} is active: run one, then activate it")
            return folder
        try:
            return self._usable(wanted, (kind,))
        except RunNotFound as error:
            raise NotUsable(f"{error}, which was to serve as {kind}") from error

    def _items(self, kinds: Collection[str]) -> tuple[LibraryItem, ...]:
        active = self._store.active.read()
        return tuple(
            _item(self._store.run(run.id), active=active.get(run.kind) == run.id)
            for run in self._store.runs()
            if run.kind in kinds and run.state is RunState.SUCCEEDED
        )

    def succeeded(self, run_id: str, kinds: Collection[str]) -> RunFolder:
        """Give a run that succeeded and is of one of these kinds.

        Raises
        ------
        RunNotFound
            If there is no such run.
        NotUsable
            If it has not succeeded, or is of another kind.
        """
        folder = self._store.run(run_id)
        try:
            kind, last = folder.record().kind, folder.state()
        except RunFolderError as error:
            raise NotUsable(f"run {run_id} cannot be read: {error}") from error
        if kind not in kinds:
            raise NotUsable(f"run {run_id} is a {kind}, not a {' or '.join(kinds)}")
        if last is None or last.state is not RunState.SUCCEEDED:
            raise NotUsable(f"run {run_id} has not succeeded: it is {last.state if last else 'without a state'}")
        return folder

    def _usable(self, run_id: str, kinds: Collection[str]) -> RunFolder:
        folder = self.succeeded(run_id, kinds)
        if CALIBRATION not in folder.results.names():
            what = f"run {run_id}, a {folder.record().kind}, has no {CALIBRATION} among its results"
            raise NotUsable(f"{what}: compute it again, or take another")
        return folder


def _item(folder: RunFolder, *, active: bool) -> LibraryItem:
    record = folder.record()
    return LibraryItem(
        id=folder.id,
        kind=record.kind,
        name=record.name,
        created=record.created,
        active=active,
        optics=record.optics,
        positions_mm=record.positions_mm,
        uses=record.uses,
    )
