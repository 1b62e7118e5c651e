"""Calibrations and references that a recipe names by their ids: refused when it is submitted, where that is certain."""

from __future__ import annotations

from collections.abc import Iterator

from irpmd_rig.processing.chain import check_uses
from irpmd_rig.processing.compensation import levels_of
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.recipes.check import Finding
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.library import ACTIVE, REFERENCE, Library
from irpmd_rig.store.record import RunRecord
from irpmd_rig.store.store import Store

_ANOTHER = "name another one, or the active one"


def unusable(record: RunRecord, store: Store) -> Iterator[Finding]:
    """Find what can serve by no means: a run that waits or is under way may, and another one may be activated yet.

    Parameters
    ----------
    record
        What the run would be.
    store
        Where the runs are that it names.
    """
    compensation = record.recipe.get("compensation")
    if isinstance(compensation, str) and not _may_succeed(store, compensation):
        try:
            levels_of(Library(store), compensation)
        except ProcessingError as error:
            yield ("compensation",), error.what, error.remedy
    named = {kind: run_id for kind, run_id in record.uses.items() if run_id != ACTIVE}
    if any(_may_succeed(store, run_id) for run_id in named.values()):
        return
    good = True
    for kind, run_id in named.items():
        try:
            Library(store).resolve(kind, run_id)
        except StoreError as error:
            good = False
            yield _place(kind), str(error), _ANOTHER
    needs_both = record.kind == "measure"
    if good and named and named.keys() == record.uses.keys() and (REFERENCE in named or not needs_both):
        try:
            check_uses(record, Library(store))
        except ProcessingError as error:
            yield _place(REFERENCE if needs_both else ""), error.what, error.remedy


def _may_succeed(store: Store, run_id: str) -> bool:
    try:
        last = store.run(run_id).state()
    except StoreError:
        return False
    return last is not None and not last.state.final


def _place(kind: str) -> tuple[str]:
    return ("reference" if kind == REFERENCE else "calibration",)
