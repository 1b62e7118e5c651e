"""Simulated projectors on a simulated USB bus, and the drivers that reach them by it."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.projector.dlpc350 import Dlpc350
from drivers.projector.lightcommander import LightCommander
from drivers.registry import make
from sims.clock import Clock
from sims.projector import dlpc350, lightcommander
from sims.projector.sequence_file import Sequence, batch_file
from sims.projector.usb_bus import UsbBus

BACKEND = "sims.projector.usb_backend:get_backend"
# Of one transfer, which takes milliseconds; short because some tests wait for it, long enough for a busy machine.
TIMEOUT_S = 0.8


@pytest.fixture
def clock() -> Iterator[Clock]:
    clock = Clock()
    yield clock
    clock.close()


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[UsbBus]:
    bus = UsbBus(tmp_path / "usb")
    bus.start()
    yield bus
    bus.close()


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[..., str]:
    """Write a sequence file as the simulated box reads it."""

    def write(exposure_us: float, period_us: float, bits: int = 8, *leds: str) -> str:
        path = tmp_path / f"{exposure_us:g}-{period_us:g}-{bits}-{'-'.join(leds) or 'all'}.bf"
        every = ("red", "green", "blue", "infrared")
        path.write_text(batch_file(Sequence(exposure_us, period_us, bits, leds or every)))
        return str(path)

    return write


@pytest.fixture
def light_box(bus: UsbBus, clock: Clock) -> Iterator[lightcommander.LightCommander]:
    box = lightcommander.LightCommander(clock)
    bus.add(box)
    yield box
    box.close()


@pytest.fixture
def light_on(bus: UsbBus, compiled: Callable[..., str]) -> Iterator[Callable[..., LightCommander]]:
    made: list[LightCommander] = []

    def build(*sequences: str, opened: bool = True, **settings: Any) -> LightCommander:
        values: dict[str, Any] = {
            "transport": "usb",
            "profile": "lightcommander-sim",
            "backend": BACKEND,
            "backend_argument": str(bus.socket_path),
            "timeout_s": TIMEOUT_S,
            "sequences": sequences or (compiled(20_000, 25_000),),
        }
        driver = make("projector", "lightcommander", "projector1", values | settings)
        assert isinstance(driver, LightCommander)
        made.append(driver)
        if opened:
            driver.open()
        return driver

    yield build
    for driver in made:
        driver.close()


def flash_image(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (1140, 912, 3), np.uint8)


FLASH = [flash_image(seed) for seed in (1, 2, 3)]


@pytest.fixture
def flash() -> list[np.ndarray]:
    return FLASH


@pytest.fixture
def flash_box(bus: UsbBus, clock: Clock) -> dlpc350.Dlpc350:
    box = dlpc350.Dlpc350(clock, flash=FLASH, kernel_driver=True)
    bus.add(box)
    return box


@pytest.fixture
def flash_on(bus: UsbBus) -> Iterator[Callable[..., Dlpc350]]:
    made: list[Dlpc350] = []

    def build(*, opened: bool = True, **settings: Any) -> Dlpc350:
        values: dict[str, Any] = {
            "led_driver_inverts": False,
            "backend": BACKEND,
            "backend_argument": str(bus.socket_path),
            "timeout_s": TIMEOUT_S,
        }
        driver = make("projector", "dlpc350", "projector1", values | settings)
        assert isinstance(driver, Dlpc350)
        made.append(driver)
        if opened:
            driver.open()
        return driver

    yield build
    for driver in made:
        driver.close()


@pytest.fixture
def leftovers() -> Callable[[], tuple[int, int]]:
    """Count the threads and descriptors of this process."""
    return lambda: (threading.active_count(), len(list(Path("/proc/self/fd").iterdir())))
