"""A small simulated world in a process of its own, and daemons on it."""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RecipeText, RigDaemon
from irpmd_rig.acquisition.rig_file import RigFile, read_rig
from irpmd_rig.acquisition.simulated import serve_command
from irpmd_rig.acquisition.status import RunStatus
from irpmd_rig.shipped import world_file
from irpmd_rig.store.states import RunState

OPTIONS: dict[str, Any] = {"size-px": 96, "time-scale": 20}
OWNER = "Ada"

STATION = """
  - {{do: move, stage: stage1, position_mm: {position_mm}}}
  - {{do: capture, label: mirror}}
"""
BEGINNING = """kind: sequence
name: stations
retries: {retries}
exposure_us: 2000.0
fringes: {{counts: [8, 7], steps: 3}}
steps:
  - {{do: prompt, text: Place the mirror., subject: mirror}}
  - {{do: show, pattern: {pattern}}}
"""


def stations(*positions_mm: float, pattern: str = "white", retries: int = 1, more: str = "") -> RecipeText:
    """A free sequence that takes frames of the mirror at each position."""
    text = BEGINNING.format(pattern=pattern, retries=retries)
    return RecipeText(text + "".join(STATION.format(position_mm=place) for place in positions_mm) + more)


@contextmanager
def served(folder: Path, **options: Any) -> Iterator[WorldControl]:
    command = serve_command(world_file("misaligned"), folder, OPTIONS | options)
    process = subprocess.Popen(
        [*command, "--until-stdin-closes"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(b"ready")
        yield WorldControl(folder)
    finally:
        process.communicate(timeout=20)


def rig_file(world: Path, root: Path) -> RigFile:
    file = read_rig("sim").with_simulation(folder=world)
    return replace(file, storage=file.storage.model_copy(update={"root": root, "reserve_gb": 0.0}))


def until(what: Callable[[], bool], limit_s: float = 20.0) -> None:
    """Wait for something that has to become true."""
    end_s = time.monotonic() + limit_s
    while not what():
        assert time.monotonic() < end_s, "it did not happen in time"
        time.sleep(0.02)


def ended(daemon: RigDaemon, run_id: str, limit_s: float = 30.0) -> RunStatus:
    """Wait for the end of a run."""
    until(lambda: (state := daemon.run(run_id).state) is not None and state.final, limit_s)
    return daemon.run(run_id)


def carried_out(daemon: RigDaemon, recipe: RecipeText) -> RunStatus:
    """Run a recipe to its end."""
    status, _ = daemon.submit(recipe)
    daemon.queue_action("resume")
    return ended(daemon, status.id)


def began(daemon: RigDaemon, recipe: RecipeText, state: RunState = RunState.RUNNING) -> str:
    """Begin a run; returns its id once it is in a state."""
    status, _ = daemon.submit(recipe)
    daemon.queue_action("resume")
    until(lambda: daemon.run(status.id).state is state)
    return status.id


def at_rest(world: WorldControl) -> None:
    """What the hardware has to be whenever a run has ended: dark, and nothing moves."""
    state = world.call("state")
    assert not state["led"] or not state["intensity"], state
    assert not any(stage["moving"] for stage in state["stages"].values()), state
    assert not state["camera"]["armed"], state
