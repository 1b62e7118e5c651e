"""Which calibrations and which reference a measurement takes that says `active`."""

from __future__ import annotations

import json
import threading
from pathlib import Path

from irpmd_rig.store.durable import write_text
from irpmd_rig.store.errors import RunFolderError


class ActiveRuns:
    """Kind of run to id, in one file that is replaced whole.

    Parameters
    ----------
    path
        The file; it need not be there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()

    def read(self) -> dict[str, str]:
        """Ids by kind; raises RunFolderError if the file is damaged."""
        try:
            content = json.loads(self.path.read_bytes())
        except FileNotFoundError:
            return {}
        except ValueError as error:
            raise RunFolderError(f"{self.path}: not JSON: {error}; mend or delete it, then activate again") from error
        if not isinstance(content, dict) or not all(isinstance(run_id, str) for run_id in content.values()):
            raise RunFolderError(f"{self.path}: not a table of ids; mend or delete it, then activate again")
        return content

    def set(self, kind: str, run_id: str) -> None:
        """Make a run the active one of its kind; it is on disk when this returns."""
        with self._lock:
            write_text(self.path, json.dumps(self.read() | {kind: run_id}, indent=2) + "\n")
