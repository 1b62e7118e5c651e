"""A small simulated world in a process of its own, and the shipped rig on it."""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.rig_file import RigFile, read_rig
from irpmd_rig.acquisition.simulated import serve_command
from irpmd_rig.shipped import world_file

OPTIONS: dict[str, Any] = {"size-px": 96, "time-scale": 20}


@contextmanager
def world(folder: Path, **options: Any) -> Iterator[WorldControl]:
    """Serve it in a folder; `options` by their names on its command line."""
    command = serve_command(world_file("misaligned"), folder, OPTIONS | options)
    process = subprocess.Popen(
        [*command, "--until-stdin-closes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"ready")
        yield WorldControl(folder)
    finally:
        process.communicate(timeout=60)


def rig_file(world_folder: Path, root: Path) -> RigFile:
    """The shipped rig on a world that is served in a folder, its runs in another."""
    file = read_rig("sim").with_simulation(folder=world_folder)
    return replace(file, storage=file.storage.model_copy(update={"root": root, "reserve_gb": 0.0}))


def until(what: Callable[[], bool], limit_s: float = 60.0) -> None:
    """Wait for something that has to become true."""
    end_s = time.monotonic() + limit_s
    while not what():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.02)
