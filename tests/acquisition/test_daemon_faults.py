"""Every fault of an instrument during a run: how it ends, that the rig is at rest, and that it goes on afterwards."""

import statistics
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest
from daemon_world import OWNER, STATION, at_rest, began, carried_out, ended, stations

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RecipeText, RigDaemon
from irpmd_rig.acquisition.rig import DeviceCondition
from irpmd_rig.store.states import Reason, RunState
from tests.small_world import rig_file, until
from tests.small_world import world as served

STAGE = {"stage": "stage1"}
ASK = "\n  - {do: prompt, text: Now.}\n"


class Fault(NamedTuple):
    """A fault, what ends it, for which reason the run may fail, and within which time."""

    name: str
    arguments: dict[str, Any]
    mended_by: tuple[str, dict[str, Any]] | None
    reasons: set[Reason]
    limit_s: float = 60.0


FAULTS = [
    Fault("camera_unplug", {}, ("camera_replug", {}), {Reason.DEVICE_LOST}),
    Fault("camera_overheat", {}, ("camera_cool", {}), {Reason.DEVICE_FAULT}),
    Fault("projector_unplug", {}, ("projector_replug", {}), {Reason.DEVICE_LOST}),
    Fault("projector_led_fault", {}, ("projector_mend", {}), {Reason.DEVICE_FAULT}),
    Fault("projector_timeout", {}, None, {Reason.DEVICE_TIMEOUT}),
    Fault("projector_stall", {}, None, {Reason.DEVICE_FAULT}),
    Fault("projector_garbled", {}, None, {Reason.DEVICE_FAULT}),
    Fault("stage_unplug", STAGE, ("stage_replug", STAGE), {Reason.DEVICE_LOST}),
    Fault("stage_stall", STAGE, None, {Reason.MOTION_FAILED}),
    Fault("stage_limit", STAGE, None, {Reason.LIMIT}),
    Fault("stage_overshoot", STAGE, None, {Reason.MOTION_FAILED}),
    Fault("stage_mute", STAGE, ("stage_mute", {**STAGE, "on": False}), {Reason.DEVICE_TIMEOUT}),
    Fault("stage_endless", STAGE, ("stage_endless", {**STAGE, "on": False}), {Reason.DEVICE_FAULT}),
]
# Whose instrument cannot be told to stop or to go dark while the fault lasts: that is the hardware's business.
UNREACHABLE = ("projector_unplug", "stage_unplug", "stage_mute", "stage_endless")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    with served(tmp_path_factory.mktemp("world")) as world:
        yield world


@pytest.fixture(scope="module")
def daemon(world: WorldControl, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RigDaemon]:
    with RigDaemon(rig_file(world.folder, tmp_path_factory.mktemp("data"))) as daemon:
        assert carried_out(daemon, stations(0)).state is RunState.SUCCEEDED
        yield daemon


def recipe(pattern: str = "white", retries: int = 1) -> RecipeText:
    """A station, a pause in which a test can do something, and two more stations."""
    rest = "".join(STATION.format(position_mm=place) for place in (5, 10))
    return stations(0, pattern=pattern, retries=retries, more=ASK + rest)


def begin(daemon: RigDaemon, wanted: RecipeText) -> str:
    """Begin a run, and return when its first station is on disk and it waits."""
    run_id = began(daemon, wanted)
    until(lambda: daemon.run(run_id).prompt is not None)
    assert daemon.run(run_id).frames
    return run_id


def go_on(daemon: RigDaemon, run_id: str) -> None:
    """Answer a run that waits, or will wait soon."""
    until(lambda: daemon.run(run_id).prompt is not None)
    lease = daemon.take_lease(OWNER, 60).id
    daemon.act(run_id, "answer", lease)
    daemon.release_lease(lease)


def nothing_but_the_queue(daemon: RigDaemon) -> bool:
    """Whether only a person's leave is missing for a run to begin."""
    return len(daemon.rig_status().reasons) == 1


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_fails_the_run_and_a_retry_succeeds(daemon: RigDaemon, world: WorldControl, fault: Fault) -> None:
    run_id = begin(daemon, recipe())
    world.call("fault", name=fault.name, **fault.arguments)
    go_on(daemon, run_id)
    status = ended(daemon, run_id, fault.limit_s)
    assert (status.state, status.reason in fault.reasons) == (RunState.FAILED, True), status
    assert status.detail
    if fault.name not in UNREACHABLE:
        at_rest(world)
    assert daemon.queue_status().held
    assert run_id in daemon.queue_status().why
    good = {entry.path for entry in daemon.store.run(run_id).manifest()}
    if fault.mended_by is not None:
        name, arguments = fault.mended_by
        world.call("fault", name=name, **arguments)
    until(lambda: nothing_but_the_queue(daemon), 30.0)
    at_rest(world)
    lease = daemon.take_lease(OWNER, 60).id
    daemon.act(run_id, "retry", lease)
    daemon.release_lease(lease)
    daemon.queue_action("resume")
    go_on(daemon, run_id)
    status = ended(daemon, run_id)
    assert (status.state, status.attempt, status.frames) == (RunState.SUCCEEDED, 2, 3), status
    at_rest(world)
    manifest = daemon.store.run(run_id).manifest()
    kept = {entry.path for entry in manifest if entry.attempt == 1}
    # A stage that was away has another zero: then nothing of the first attempt is mixed in.
    assert kept == (set() if fault.name == "stage_unplug" else good)


@pytest.mark.parametrize("name", ["frame_dropped", "frame_incomplete", "frame_late", "trigger_missed", "sync_missed"])
def test_a_frame_that_does_not_come_is_taken_again(daemon: RigDaemon, world: WorldControl, name: str) -> None:
    run_id = begin(daemon, recipe(pattern="fringes"))
    world.call("fault", name=name)
    go_on(daemon, run_id)
    status = ended(daemon, run_id, 80.0)
    assert (status.state, status.frames) == (RunState.SUCCEEDED, 18), status
    manifest = daemon.store.run(run_id).manifest()
    assert [(entry.station, entry.set, entry.step) for entry in manifest] == [
        (station, number, step) for station in range(3) for number in range(2) for step in range(3)
    ]


def test_frames_that_never_come_end_the_run(daemon: RigDaemon, world: WorldControl) -> None:
    run_id = begin(daemon, recipe(retries=0))
    world.call("fault", name="frame_dropped", frames=10_000)
    go_on(daemon, run_id)
    status = ended(daemon, run_id, 60.0)
    assert (status.state, status.reason) == (RunState.FAILED, Reason.FRAMES_LOST)
    at_rest(world)
    world.call("fault", name="frame_dropped", frames=1)
    assert carried_out(daemon, stations(0)).state is RunState.SUCCEEDED


def test_an_instrument_that_goes_away_while_nothing_runs_is_told_and_comes_back(
    daemon: RigDaemon, world: WorldControl
) -> None:
    daemon.queue_action("resume")
    with daemon.events.subscribe() as reader:
        world.call("fault", name="projector_unplug")
        until(lambda: daemon.rig_status().devices["projector"].state is DeviceCondition.LOST)
        until(lambda: daemon.queue_status().held)
        status = daemon.rig_status()
        assert not status.can_start
        assert any(reason.startswith("projector is lost") for reason in status.reasons)
        assert status.devices["camera"].state is DeviceCondition.READY
        world.call("fault", name="projector_replug")
        until(lambda: daemon.rig_status().devices["projector"].state is DeviceCondition.READY, 30.0)
        until(lambda: len(reader.take() or []) == 0)
    # It came back, but nothing starts by itself.
    assert daemon.queue_status().held


def test_a_device_that_is_away_never_holds_up_who_asks(daemon: RigDaemon, world: WorldControl) -> None:
    world.call("fault", name="camera_hang")
    try:
        waits_s = []
        end_s = time.monotonic() + 3.0
        while time.monotonic() < end_s:
            began_s = time.monotonic()
            daemon.rig_status()
            waits_s.append(time.monotonic() - began_s)
            time.sleep(0.01)
        # Who waited for the camera would ask once or twice in all that time.
        assert statistics.median(waits_s) < 0.3
        assert len(waits_s) >= 5
    finally:
        world.call("fault", name="camera_recover")
    until(lambda: daemon.rig_status().devices["camera"].state is DeviceCondition.READY, 30.0)
