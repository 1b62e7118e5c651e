"""What daemons on a small simulated world are asked for."""

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RecipeText, RigDaemon
from irpmd_rig.acquisition.status import RunStatus
from irpmd_rig.store.states import RunState
from tests.small_world import until

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


def ended(daemon: RigDaemon, run_id: str, limit_s: float = 80.0) -> RunStatus:
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
