"""A LightCommander or a DLPC350 whose patterns come by the video input: USB sets the light, the window the picture."""

import shutil
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.errors import DeviceFault, DeviceLost, Refused
from drivers.projector.base import PatternProjector
from drivers.protocols import Led, PatternSequence, ProjectorCondition, SyncOutput
from sims.clock import Clock
from sims.projector import dlpc350, lightcommander
from sims.projector.usb_bus import UsbBus
from tests.small_world import until

DELAY_S = 0.1


class Picture:
    """What is on a virtual screen, as the box behind it gets it."""

    def __init__(self, display: str, width: int, height: int) -> None:
        self.display = display
        self.width, self.height = width, height

    def colours(self) -> np.ndarray:
        import mss

        with mss.MSS(display=self.display) as grabber:
            shot = grabber.grab({"left": 0, "top": 0, "width": self.width, "height": self.height})
        return np.frombuffer(shot.raw, np.uint8).reshape(self.height, self.width, 4)[..., 2::-1]

    def grey(self) -> np.ndarray:
        return self.colours()[..., 1]


@pytest.fixture
def picture(request: pytest.FixtureRequest) -> Iterator[Picture]:
    width, height = request.param
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        pytest.skip("no Xvfb: install Debian's package xvfb")
    command = [xvfb, "-displayfd", "1", "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        yield Picture(f":{server.stdout.readline().strip()}", width, height)
        server.terminate()


def video(picture: Picture) -> dict[str, Any]:
    return {
        "x_display": picture.display,
        "size_px": (picture.width, picture.height),
        "display_delay_s": DELAY_S,
    }


def patterns(picture: Picture) -> np.ndarray:
    return np.random.default_rng(2).integers(0, 256, (2, picture.height, picture.width), np.uint8)


def shows(driver: PatternProjector, box: Any, images: np.ndarray) -> None:
    for index in (1, 0):
        driver.show(index)
        shown = box.showing()
        assert np.array_equal(shown.image, images[index])
        assert shown.led == "green"


@pytest.mark.parametrize("picture", [(1024, 768)], indirect=True)
def test_lightcommander(picture: Picture, bus: UsbBus, clock: Clock, light_on: Callable[..., Any]) -> None:
    box = lightcommander.LightCommander(clock, video=picture.grey)
    bus.add(box)
    driver = light_on(sequences=(), video=video(picture))
    assert not driver.capabilities().self_paced
    images = patterns(picture)
    driver.load(images)
    driver.set_led(Led.GREEN, 0.4)
    shows(driver, box, images)
    assert driver.stop().stopped
    assert not box.showing().image.any()
    box.faults.usb.stall_next()
    with pytest.raises(DeviceFault):
        driver.set_led(Led.GREEN, 0.4)
    assert box.showing().level == 0
    driver.set_led(Led.GREEN, 0.4)
    driver.order(PatternSequence((0, 1), exposure_us=100_000))
    driver.run_once()
    assert driver.status().condition is ProjectorCondition.RUNNING
    until(lambda: driver.status().condition is ProjectorCondition.DARK)
    shows(driver, box, images)
    # The window may die, and the light is turned off by USB all the same.
    driver._screen._child._process.kill()
    with pytest.raises(DeviceLost):
        driver.show(0)
    assert box.showing().level == 0
    driver.load(images)
    driver.set_led(Led.GREEN, 0.4)
    shows(driver, box, images)
    driver.close()
    assert box.showing().level == 0
    box.close()


@pytest.mark.parametrize("picture", [(912, 1140)], indirect=True)
def test_dlpc350(picture: Picture, bus: UsbBus, clock: Clock, flash_on: Callable[..., Any]) -> None:
    box = dlpc350.Dlpc350(clock, video=picture.colours)
    bus.add(box)
    driver = flash_on(video=video(picture))
    assert driver.capabilities().can_load
    images = patterns(picture)
    driver.load(images)
    driver.set_led(Led.GREEN, 0.4)
    shows(driver, box, images)
    driver.configure_sync(SyncOutput(enabled=True))
    shows(driver, box, images)
    assert driver.stop().stopped
    assert box.showing().image is None or not box.showing().image.any()
    shows(driver, box, images)
    driver.park()
    driver.unpark()
    driver.set_led(Led.GREEN, 0.4)
    shows(driver, box, images)
    with pytest.raises(Refused, match="do not fit"):
        driver.load(images[:, :768])
    driver.close()
    assert box.showing().level == 0
