"""The rig over HTTP: resources, events, files, figures; RFC 9457 problems for whatever goes wrong.

Its parts are loaded when they are asked for: a client needs the models alone, and not the rig behind them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from irpmd_rig.service.app import create_app
    from irpmd_rig.service.server import serve
    from irpmd_rig.service.settings import ServiceSettings

__all__ = ["ServiceSettings", "create_app", "serve"]

_PARTS = {"ServiceSettings": "settings", "create_app": "app", "serve": "server"}


def __getattr__(name: str) -> Any:
    if name not in _PARTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PARTS[name]}"), name)
