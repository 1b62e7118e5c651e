"""Whether the results of a run are all there: one document is written last, and taken away first."""

from __future__ import annotations

from irpmd_rig.store.results import CALIBRATION, RESULT, Results

_LAST = (RESULT, CALIBRATION)


def withdraw(results: Results) -> None:
    """Delete results; whenever this is cut off, what is left can be told from whole ones."""
    for name in _LAST:
        if name in results.names():
            results.path(name).unlink()
    results.clear()


def withdraw_partial(results: Results) -> None:
    """Delete what a computation left that was killed or cancelled: without its last document it is no result."""
    names = results.names()
    if names and not set(_LAST) & set(names):
        results.clear()
