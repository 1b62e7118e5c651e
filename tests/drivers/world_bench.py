"""Drivers for every instrument of a simulated world, and one good operation of each seen from both ends."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.camera.camera import HarvestersCamera
from drivers.errors import InstrumentError
from drivers.projector.lightcommander import LightCommander
from drivers.registry import make
from drivers.stage.engine import SerialStage
from drivers.values import CameraSettings, Led, PatternSequence
from irpmd_rig.acquisition.rig_file import read_rig
from irpmd_rig.acquisition.simulated import attach

SIZE_PX = 64
TIME_SCALE = 20
NEAR_MM = 0.06
PATTERNS = np.random.default_rng(1).integers(0, 256, (4, 768, 1024), np.uint8)
ORDER = PatternSequence((0, 1, 2, 3), 8000.0)
# Every operation here is bounded by a few seconds: it has ended by then on any machine, and what hangs has not.
HANG_S = 40.0
# Bounds of single answers, short so that the tests are.
SETTINGS: dict[str, dict[str, Any]] = {
    "camera": {"answer_timeout_s": 2.0},
    "projector": {"timeout_s": 1.0},
    "stage1": {"progress_timeout_s": 0.5, "reconnect_s": 0.5},
    "stage2": {"progress_timeout_s": 0.5, "reconnect_s": 0.5},
}


class WorldBench:
    """A world's process, and drivers for all of its instruments."""

    light = (Led.INFRARED, 0.5)

    def __init__(self) -> None:
        rig_file = read_rig("sim").with_simulation(private=True, size_px=SIZE_PX, time_scale=TIME_SCALE)
        filled, self.operator = attach(rig_file)
        made = {
            name: make(device.kind, device.driver, name, {**device.settings, **SETTINGS[name]})
            for name, device in filled.devices.items()
        }
        self.camera: HarvestersCamera = made["camera"]
        self.projector: LightCommander = made["projector"]
        self.stages: dict[str, SerialStage] = {name: made[name] for name in ("stage1", "stage2")}
        self.instruments = made

    def world(self, call: str, **arguments: Any) -> dict[str, Any]:
        return self.operator.control.call(call, **arguments)

    def fault(self, name: str, **arguments: Any) -> None:
        self.world("fault", name=name, **arguments)

    def soon(self, name: str, **arguments: Any) -> None:
        """Let a fault come while the next operation is under way."""
        threading.Timer(0.15, self.fault, (name,), arguments).start()

    def open(self) -> None:
        for instrument in self.instruments.values():
            instrument.open()

    def close(self) -> None:
        for instrument in self.instruments.values():
            instrument.close()

    def mend(self) -> None:
        for device in ("camera", "projector"):
            self.fault(f"{device}_replug")
        for stage in self.stages:
            self.fault("stage_replug", stage=stage)
        self.fault("camera_recover")
        self.fault("camera_slow", seconds=0.0)
        self.fault("projector_mend")

    # ---- one good operation of each, seen from both ends

    def shoot(self) -> None:
        self.camera.stop()
        self.camera.configure(CameraSettings(exposure_us=2000.0, pixel_format="Mono8", trigger="software"))
        self.camera.arm(1)
        self.camera.trigger()
        frame = self.camera.fetch(3.0)
        assert (frame.index, frame.image.shape) == (0, (SIZE_PX, SIZE_PX))
        self.camera.stop()

    def project(self, *, look: bool = True) -> None:
        self.projector.stop()
        self.projector.load(PATTERNS)
        self.projector.set_led(*self.light)
        self.projector.order(ORDER)
        self.projector.show(2)
        if look:
            state = self.world("state")
            assert (state["led"], state["light"]) == ("infrared", True)

    def move(self, name: str) -> None:
        stage = self.stages[name]
        stage.stop()
        if stage.state().position is None:
            stage.home()
        target_mm = 3.0 if stage.position().position_mm > 5.0 else 12.0
        stage.move_to(target_mm)
        assert stage.wait().position_mm == pytest.approx(target_mm, abs=0.01)
        true_mm = self.world("state")["stages"][name]["position_mm"]
        assert true_mm == pytest.approx(target_mm, abs=NEAR_MM), f"{name} stands at {true_mm}, not at {target_mm}"

    def works(self) -> None:
        """Every instrument does its work, at the latest once its line has come back."""
        for operation in (self.shoot, self.project, lambda: self.move("stage1"), lambda: self.move("stage2")):
            eventually(operation)


def eventually(operation: Callable[[], None], within_s: float = 30.0) -> None:
    give_up_s = time.monotonic() + within_s
    while True:
        try:
            return operation()
        except InstrumentError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.05)


@contextmanager
def raised(device: str, *errors: type[InstrumentError]) -> Iterator[None]:
    began_s = time.monotonic()
    with pytest.raises(errors) as caught:
        yield
    assert time.monotonic() - began_s < HANG_S
    assert type(caught.value) in errors
    assert caught.value.device == device
    assert caught.value.remedy
