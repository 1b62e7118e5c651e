"""Every fault of the running world: a typed error within its bound, and then a rig that works."""

import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from world_client import ServedWorld

from drivers.protocols import (
    CameraSettings,
    DeviceFault,
    DeviceLost,
    FramesLost,
    GarbledReply,
    IncompleteFrame,
    InstrumentError,
    Led,
    LimitReached,
    MotionFailed,
    PatternSequence,
    SyncOutput,
    TimedOut,
)

FRAME_LIMIT_S = 1.0
# Of one operation that fails: answer time-outs are half a second below, a line's is one.
# On any machine; what hangs takes longer.
BOUND_S = 30.0
ORDER = PatternSequence((0, 1, 2, 3), 8000.0)

# Fault, its arguments, the error of the next operation, and what ends it.
CAMERA = [
    ("frame_dropped", {}, FramesLost, None),
    ("frame_incomplete", {"share": 0.2}, IncompleteFrame, None),
    ("frame_late", {"seconds": 40.0}, TimedOut, None),
    ("trigger_missed", {}, TimedOut, None),
    ("sync_missed", {}, TimedOut, None),
    ("camera_hang", {}, TimedOut, ("camera_recover", {})),
    ("camera_node_error", {}, DeviceFault, None),
    ("camera_node_error", {"node": "PixelFormat", "access": "read"}, DeviceFault, None),
    ("camera_slow", {"seconds": 3.0}, TimedOut, ("camera_slow", {"seconds": 0.0})),
    ("camera_unplug", {}, DeviceLost, ("camera_replug", {})),
]
PROJECTOR = [
    ("projector_stall", {}, DeviceFault, None),
    ("projector_timeout", {}, TimedOut, None),
    ("projector_garbled", {}, GarbledReply, None),
    ("projector_led_fault", {}, DeviceFault, ("projector_mend", {})),
    ("projector_overheat", {}, DeviceFault, None),
    ("projector_unplug", {}, DeviceLost, ("projector_replug", {})),
]
STAGE = [
    ("stage_stall", {}, MotionFailed, None),
    ("stage_limit", {}, LimitReached, None),
    ("stage_overshoot", {"by_mm": 0.1}, MotionFailed, None),
    ("stage_slow", {"seconds": 40.0}, TimedOut, ("stage_slow", {"seconds": 0.0})),
    ("stage_mute", {}, TimedOut, ("stage_mute", {"on": False})),
    ("stage_garbled", {}, InstrumentError, None),
    ("stage_endless", {}, GarbledReply, ("stage_endless", {"on": False})),
    ("stage_unplug", {}, DeviceLost, ("stage_replug", {})),
]
HARMLESS_TO_DRIVERS = {"camera_overheat", "camera_cool", "stage_lost_steps"}


@pytest.fixture(scope="module")
def rig(world: ServedWorld) -> Iterator[SimpleNamespace]:
    devices = SimpleNamespace(
        camera=world.camera(answer_timeout_s=1.5),
        projector=world.projector(timeout_s=1.0),
        stage=world.stage("stage1", progress_timeout_s=0.3, reconnect_s=0.3),
    )
    try:
        for device in vars(devices).values():
            device.open()
        prepare(devices.projector)
        devices.stage.home()
        yield devices
    finally:
        for device in vars(devices).values():
            device.close()


def prepare(projector: Any) -> None:
    projector.load(np.zeros((4, 768, 1024), np.uint8))
    projector.set_led(Led.INFRARED, 0.5)
    projector.order(ORDER)
    projector.configure_sync(SyncOutput(enabled=True))


def burst(rig: SimpleNamespace) -> list[int]:
    rig.camera.configure(CameraSettings(exposure_us=5000.0, pixel_format="Mono8", trigger="hardware"))
    rig.camera.arm(4)
    rig.projector.run_once()
    try:
        return [frame.index for frame in rig.camera.frames(FRAME_LIMIT_S)]
    finally:
        rig.camera.stop()
        # The rest of the pass must not trigger the next burst.
        time.sleep(0.1)


def eventually(operation: Callable[[], Any], within_s: float = 30.0) -> Any:
    give_up_s = time.monotonic() + within_s
    while True:
        try:
            return operation()
        except InstrumentError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.1)


def fails(operation: Callable[[], Any], error: type[InstrumentError]) -> None:
    start_s = time.monotonic()
    with pytest.raises(error):
        operation()
    assert time.monotonic() - start_s < BOUND_S


@pytest.mark.parametrize(("fault", "arguments", "error", "end"), CAMERA)
def test_camera_and_sync(
    world: ServedWorld, rig: SimpleNamespace, fault: str, arguments: Any, error: type[InstrumentError], end: Any
) -> None:
    world("fault", name=fault, **arguments)
    fails(lambda: burst(rig), error)
    if end:
        world("fault", name=end[0], **end[1])
    # What came too late is of an earlier burst, and never in this one.
    assert eventually(lambda: burst(rig)) == [0, 1, 2, 3]


def test_a_hot_camera_shows_it(world: ServedWorld, rig: SimpleNamespace) -> None:
    world("fault", name="camera_overheat", temperature_c=77.0)
    assert rig.camera.temperature_c() == 77.0
    world("fault", name="camera_cool")
    assert rig.camera.temperature_c() < 50.0


@pytest.mark.parametrize(("fault", "arguments", "error", "end"), PROJECTOR)
def test_projector(
    world: ServedWorld, rig: SimpleNamespace, fault: str, arguments: Any, error: type[InstrumentError], end: Any
) -> None:
    def light() -> None:
        rig.projector.set_led(Led.INFRARED, 0.4)
        rig.projector.set_led(Led.INFRARED, 0.5)
        rig.projector.show(0)

    world("fault", name=fault, **arguments)
    fails(light, error)
    assert world("state")["led"] is None or fault == "projector_unplug"
    if end:
        world("fault", name=end[0], **end[1])
    eventually(lambda: prepare(rig.projector))
    light()
    assert world("state")["led"] == "infrared"


@pytest.mark.parametrize(("fault", "arguments", "error", "end"), STAGE)
def test_stage(
    world: ServedWorld, rig: SimpleNamespace, fault: str, arguments: Any, error: type[InstrumentError], end: Any
) -> None:
    def move() -> None:
        rig.stage.move_to(30.0)
        rig.stage.wait()

    world("fault", name=fault, stage="stage1", **arguments)
    fails(move, error)
    if end:
        world("fault", name=end[0], stage="stage1", **end[1])
    eventually(rig.stage.home)
    rig.stage.move_to(5.0)
    assert rig.stage.wait().position_mm == pytest.approx(5.0, abs=0.01)
    assert world("state")["stages"]["stage1"]["position_mm"] == pytest.approx(5.0, abs=0.01)
    rig.stage.home()


def test_lost_steps_are_known_to_the_world_alone(world: ServedWorld, rig: SimpleNamespace) -> None:
    world("fault", name="stage_lost_steps", stage="stage1", counts=250)
    rig.stage.move_to(10.0)
    assert rig.stage.wait().position_mm == pytest.approx(10.0, abs=0.01)
    assert world("state")["stages"]["stage1"]["position_mm"] == pytest.approx(9.75, abs=0.01)
    rig.stage.home()
    assert world("state")["stages"]["stage1"]["position_mm"] == pytest.approx(0.0, abs=0.01)


def test_no_fault_is_left_out(world: ServedWorld) -> None:
    tried = {fault for fault, *_ in (*CAMERA, *PROJECTOR, *STAGE)}
    ended = {end[0] for *_, end in (*CAMERA, *PROJECTOR, *STAGE) if end}
    assert set(world("fault_names")["names"]) == tried | ended | HARMLESS_TO_DRIVERS
    assert {entry["name"] for entry in world("injected")["injected"]} >= tried


def test_random_faults_come_while_it_runs_and_end_when_they_are_switched_off(
    world: ServedWorld, rig: SimpleNamespace
) -> None:
    before = len(world("injected")["injected"])
    world("faults", seed=3, rate_per_s=5.0, names=["camera_unplug", "stage_unplug", "projector_unplug"])
    deadline_s = time.monotonic() + 30
    while len(world("injected")["injected"]) < before + 8:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    world("faults", seed=None)
    state = world("state")
    assert state["camera"]["plugged"]
    assert all(stage["plugged"] for stage in state["stages"].values())
    eventually(lambda: prepare(rig.projector))
    assert eventually(lambda: burst(rig)) == [0, 1, 2, 3]
    came = len(world("injected")["injected"])
    time.sleep(0.3)
    assert len(world("injected")["injected"]) == came
