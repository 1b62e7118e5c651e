"""The levels that a characterised gamma gives to fringes."""

from __future__ import annotations

from irpmd_rig.processing.errors import Refused
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.library import Library
from irpmd_rig.store.results import RESULT

_ANOTHER = "name a run of kind characterise, what: gamma, that has succeeded"


def levels_of(library: Library, run_id: str | None) -> bytes | None:
    """Read the table of 256 levels of a run that characterised the gamma; None where none is named.

    Raises
    ------
    Refused
        There is no such run, it has not succeeded, or it has no such table.
    """
    if run_id is None:
        return None
    try:
        table = library.succeeded(run_id, ("characterise",)).results.read_json(RESULT)["table"]
        levels = bytes(table)
    except (StoreError, KeyError, TypeError, ValueError) as error:
        raise Refused(f"compensation {run_id} cannot be used: {error}", _ANOTHER) from None
    if len(levels) != 256:
        raise Refused(f"compensation {run_id} has {len(levels)} levels, not 256", _ANOTHER)
    return levels
