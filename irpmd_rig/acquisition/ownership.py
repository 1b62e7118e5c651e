"""One daemon a store."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.store.durable import typed_errors

LOCK = ".daemon.lock"


class AlreadyRunning(AcquisitionError):
    """Another daemon works on this store."""


def lock_store(root: Path) -> int:
    """Lock a store's folder, which is made if it is not there, for this process.

    The kernel gives it free when the process is gone, however that ends.

    Returns
    -------
    int
        A descriptor: closing it gives the store free.

    Raises
    ------
    AlreadyRunning
        Another process has it.
    DiskFull, WriteFailed
        The folder cannot be made.
    """
    with typed_errors(root):
        root.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(root / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise AlreadyRunning(f"another daemon works on {root}", "stop it, or choose another storage.root") from None
    return descriptor
