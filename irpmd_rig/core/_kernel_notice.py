"""Say once that a kernel is being compiled, so that nobody takes the first call for a slow one."""

from __future__ import annotations

import logging
from typing import Any

from numba.core import event

_logger = logging.getLogger("irpmd_rig")


class _Announcer(event.Listener):  # type: ignore[misc]
    """Hears every compilation of Numba; speaks at those of announced kernels.

    The event comes when a function is really compiled, not when it is loaded from the cache.
    """

    def __init__(self) -> None:
        self._names: dict[Any, str] = {}

    def announce(self, dispatcher: Any, name: str) -> None:
        self._names[dispatcher] = name

    def on_start(self, event: Any) -> None:
        name = self._names.get(event.data.get("dispatcher"))
        if name is not None:
            _logger.warning("compiling %s (a few seconds, once; cached afterwards)", name)

    def on_end(self, event: Any) -> None:
        """Nothing to say: the result of the call is the sign that it is done."""


_announcer = _Announcer()
event.register("numba:compile", _announcer)


def announce_compilation(dispatcher: Any, name: str) -> None:
    """Log a warning (logger ``irpmd_rig``) when a compiled function is built for the first time.

    Parameters
    ----------
    dispatcher
        What ``numba.njit`` returned.
    name
        What is said to be compiled, for example "the decoding kernel".
    """
    _announcer.announce(dispatcher, name)
