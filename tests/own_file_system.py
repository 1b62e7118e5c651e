"""A small file system of a process's own: where the machine allows to mount one."""

import functools
import os
import subprocess
import tempfile
from pathlib import Path

# What its command line begins with: a name space of mounts in which it may mount.
OWN = ("unshare", "--mount") if os.geteuid() == 0 else ("unshare", "--map-root-user", "--mount")


def mounted(folder: Path, size_mb: int) -> tuple[str, ...]:
    """What a command line begins with whose process alone sees an empty file system of a size in a folder."""
    return (*OWN, "sh", "-c", f'mount -t tmpfs -o size={size_mb}m runs "{folder}" && exec "$@"', "sh")


@functools.cache
def why_not() -> str:
    """Why none can be had here; empty where it can."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run([*mounted(Path(folder), 1), "true"], capture_output=True, text=True, check=False)
    return done.stderr.strip() if done.returncode else ""
