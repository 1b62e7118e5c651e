"""Where the command line begins, and how it ends when something was wrong."""

from __future__ import annotations

import logging
import sys
from importlib import import_module

from rich.logging import RichHandler

from irpmd_rig.cli.application import app, note, notes

# Each enters its commands in the application, in the order in which the help shows them.
GROUPS = ("daemon", "run", "runs", "rig", "checking", "folders", "report", "demo", "reproduce", "world", "bench")
for group in GROUPS:
    import_module(f"irpmd_rig.cli.{group}")

# By module and name: an error can only have been raised if its module was loaded, and loading takes time.
_BAD_INPUT = (
    ("irpmd_rig.core.errors", "MeasurementError"),
    ("irpmd_rig.acquisition.errors", "AcquisitionError"),
    ("irpmd_rig.client.errors", "ClientError"),
    ("irpmd_rig.processing.errors", "ProcessingError"),
    ("irpmd_rig.recipes.document", "DocumentError"),
    ("irpmd_rig.store.errors", "StoreError"),
    ("drivers.errors", "InstrumentError"),
)


def main() -> None:
    """Run the command line; bad input ends in one line for each thing that is wrong, and exit status 2."""
    logging.basicConfig(
        level=logging.WARNING,
        format="%(message)s",
        handlers=[RichHandler(console=notes, show_time=False, show_level=False, show_path=False)],
    )
    try:
        app()
    except Exception as error:
        if not isinstance(error, (OSError, *_loaded())):
            raise
        note(f"error: {error}", style="red")
        sys.exit(2)


def _loaded() -> tuple[type[Exception], ...]:
    return tuple(getattr(sys.modules[module], name) for module, name in _BAD_INPUT if module in sys.modules)
