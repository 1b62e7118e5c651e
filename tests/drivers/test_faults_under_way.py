"""Faults that strike in the middle of an operation, through the real drivers on a world's process: a typed error
within a bound, the other instruments go on, and the next operation works once the fault is mended."""

import os
import signal
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from world_bench import HANG_S, PATTERNS, WorldBench, raised

from drivers.errors import DeviceFault, DeviceLost, InstrumentError, MotionFailed, NotConnected, Refused, TimedOut
from drivers.values import CameraSettings, SyncOutput

# ---- the camera


def test_unplugged_while_a_trigger_is_awaited(bench: WorldBench) -> None:
    bench.camera.configure(CameraSettings(exposure_us=2000.0, pixel_format="Mono8", trigger="hardware"))
    bench.camera.arm(3)
    bench.soon("camera_unplug")
    with raised("camera", DeviceLost):
        bench.camera.fetch(3.0)
    with raised("camera", DeviceLost, NotConnected):
        bench.camera.arm(1)
    bench.move("stage1")
    bench.project()
    bench.fault("camera_replug")
    bench.works()


def test_the_camera_s_process_is_killed_while_frames_stream(bench: WorldBench) -> None:
    bench.camera.configure(CameraSettings(exposure_us=2000.0, pixel_format="Mono8"))
    bench.camera.arm()
    killed = bench.camera.process_id
    threading.Timer(0.15, os.kill, (killed, signal.SIGKILL)).start()
    with raised("camera", DeviceLost):
        while True:
            bench.camera.fetch(30.0)
    bench.works()
    assert bench.camera.process_id != killed


def test_a_camera_that_is_too_hot_is_not_armed(bench: WorldBench) -> None:
    bench.fault("camera_overheat", temperature_c=85.0)
    with raised("camera", DeviceFault):
        bench.camera.arm(1)
    assert bench.world("state")["camera"]["armed"] is False
    bench.fault("camera_cool")
    bench.works()


# ---- the projector


def test_unplugged_while_patterns_are_loaded(bench: WorldBench) -> None:
    bench.soon("projector_unplug")
    with raised("projector", DeviceLost):
        while True:
            # Planes that the box has already are not sent again.
            bench.projector.load(np.random.default_rng().integers(0, 256, PATTERNS.shape, np.uint8))
    with raised("projector", NotConnected, DeviceLost):
        bench.projector.stop()
    bench.shoot()
    bench.fault("projector_replug")
    bench.works()


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        ("projector_stall", DeviceFault),
        ("projector_timeout", TimedOut),
        ("projector_led_fault", DeviceFault),
        ("projector_overheat", DeviceFault),
    ],
)
def test_a_fault_while_a_sequence_runs_leaves_no_light(
    bench: WorldBench, fault: str, error: type[InstrumentError]
) -> None:
    bench.projector.configure_sync(SyncOutput(enabled=True))
    bench.projector.repeat()
    assert bench.world("state")["running"]
    bench.fault(fault)
    with raised("projector", error):
        for _ in range(3):
            # A pass under way takes no other order: the box is asked how it is, first.
            status = bench.projector.status()
            if status.faults:
                bench.projector.stop()
                bench.projector.set_led(*bench.light)
                bench.projector.show(0)
    assert bench.world("state")["led"] is None
    bench.fault("projector_mend")
    bench.works()


def test_missed_pulses_are_a_time_out_at_the_camera(bench: WorldBench) -> None:
    bench.projector.configure_sync(SyncOutput(enabled=True))
    bench.camera.configure(CameraSettings(exposure_us=2000.0, pixel_format="Mono8", trigger="hardware"))
    bench.camera.arm(4)
    bench.fault("sync_missed", edges=2)
    bench.projector.run_once()
    with raised("camera", TimedOut):
        for _ in range(4):
            bench.camera.fetch(0.5)
    bench.camera.stop()
    bench.works()


# ---- the stages


def test_one_stage_is_unplugged_and_the_other_arrives(bench: WorldBench) -> None:
    # So slow that it is on its way whenever the fault comes.
    bench.stages["stage1"].set_speed(4.0)
    for stage in bench.stages.values():
        stage.move_to(150.0)
    bench.soon("stage_unplug", stage="stage1")
    with raised("stage1", DeviceLost):
        bench.stages["stage1"].wait()
    assert bench.stages["stage2"].wait().position_mm == pytest.approx(150.0, abs=0.01)
    assert bench.stages["stage1"].state().position is None
    bench.fault("stage_replug", stage="stage1")
    with raised("stage1", Refused):
        bench.stages["stage1"].move_to(1.0)
    bench.stages["stage1"].set_speed(20.0)
    bench.works()


def test_stop_reaches_everything_while_everything_fails(bench: WorldBench) -> None:
    """Whatever goes on, `stop` of each ends within its bound, by an answer or a typed error."""
    for stage in bench.stages.values():
        stage.move_to(190.0)
    bench.camera.configure(CameraSettings(exposure_us=2000.0, pixel_format="Mono8"))
    bench.camera.arm()
    bench.projector.repeat()
    bench.fault("stage_garbled", stage="stage1", replies=2)
    bench.fault("projector_garbled", replies=1)
    bench.fault("camera_slow", seconds=3.0)
    for instrument in bench.instruments.values():
        began_s = time.monotonic()
        with suppress(InstrumentError):
            assert instrument.stop().stopped
        assert time.monotonic() - began_s < HANG_S
    bench.fault("camera_slow", seconds=0.0)
    state = bench.world("state")
    assert not state["running"]
    assert not state["stages"]["stage2"]["moving"]
    with raised("stage2", MotionFailed):
        bench.stages["stage2"].wait()
    bench.works()
