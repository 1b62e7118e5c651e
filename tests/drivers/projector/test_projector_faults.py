"""Every fault of the simulated boxes ends in its typed error, within its bound, dark; then all works again."""

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import usb.backend
import usb.backend.libusb1

from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    GarbledReply,
    InstrumentError,
    NotConnected,
    Refused,
    TimedOut,
)
from drivers.projector.base import PatternProjector
from drivers.protocols import Led, PatternSequence, ProjectorCondition
from drivers.registry import make
from sims.projector import dlpc350, lightcommander

On = Callable[..., Any]
# Transfers of 0.8 s: the one that fails, and what turns the light off. A busy machine adds its own; a hang has no end.
BOUND_S = 30.0
IMAGES = np.random.default_rng(5).integers(0, 256, (2, 768, 1024), np.uint8)


class Pair:
    """A driver that shows a pattern, and the box that it shows it with."""

    def __init__(self, driver: PatternProjector, box: Any, usb_faults: Any, load: bool) -> None:
        self.driver, self.box, self.usb, self._load = driver, box, usb_faults, load

    def make_ready(self) -> None:
        if self._load:
            self.driver.load(IMAGES)
        self.driver.set_led(Led.RED, 0.3)
        self.driver.order(PatternSequence((0, 1), exposure_us=20_000))
        self.driver.show(0)
        assert self.box.showing().led == "red"


@pytest.fixture(params=["lightcommander", "dlpc350"])
def pair(request: pytest.FixtureRequest) -> Pair:
    if request.param == "lightcommander":
        box = request.getfixturevalue("light_box")
        driver = request.getfixturevalue("light_on")()
    else:
        box = request.getfixturevalue("flash_box")
        driver = request.getfixturevalue("flash_on")()
    found = Pair(driver, box, box.faults.usb, load=request.param == "lightcommander")
    found.make_ready()
    time.sleep(0.001)
    return found


def fails(operation: Callable[[], object], *errors: type[InstrumentError]) -> InstrumentError:
    begun_s = time.monotonic()
    with pytest.raises(errors) as caught:
        operation()
    assert time.monotonic() - begun_s < BOUND_S
    assert caught.value.device == "projector1"
    assert caught.value.remedy
    return caught.value


def test_a_stalled_endpoint(pair: Pair) -> None:
    pair.usb.stall_next()
    fails(lambda: pair.driver.show(1), DeviceFault)
    assert pair.box.showing().level == 0
    with pytest.raises(Refused, match="turned off after an error"):
        pair.driver.show(0)
    pair.make_ready()


def test_a_transfer_that_times_out(pair: Pair) -> None:
    pair.usb.time_out_next()
    fails(lambda: pair.driver.show(1), TimedOut)
    assert pair.box.showing().level == 0
    pair.make_ready()


def test_a_box_that_goes_silent(pair: Pair) -> None:
    pair.usb.mute = True
    fails(lambda: pair.driver.show(1), TimedOut)
    fails(pair.driver.status, TimedOut)
    fails(pair.driver.stop, TimedOut)
    pair.usb.clear()
    pair.make_ready()
    assert pair.driver.stop().stopped


@pytest.mark.parametrize("replies", [1, 3])
def test_garbled_replies(pair: Pair, replies: int) -> None:
    pair.usb.garble_next(replies)
    fails(lambda: pair.driver.show(1), GarbledReply)
    pair.usb.clear()
    pair.make_ready()


def test_an_error_of_status_turns_the_light_off(pair: Pair) -> None:
    pair.usb.garble_next()
    fails(pair.driver.status, GarbledReply)
    assert pair.box.showing().level == 0
    assert pair.driver.status().condition is ProjectorCondition.DARK
    pair.make_ready()


def test_unplugged_and_plugged_in_again(pair: Pair) -> None:
    pair.usb.unplug()
    fails(lambda: pair.driver.show(1), DeviceLost)
    fails(lambda: pair.driver.show(1), NotConnected)
    fails(pair.driver.status, NotConnected)
    fails(pair.driver.stop, NotConnected)
    pair.usb.replug()
    assert pair.driver.status().condition is ProjectorCondition.DARK
    assert pair.box.showing().level == 0
    pair.make_ready()


def test_stop_after_replugging_makes_it_dark(pair: Pair) -> None:
    pair.usb.unplug()
    fails(pair.driver.stop, DeviceLost)
    pair.usb.replug()
    assert pair.driver.stop().stopped
    assert pair.box.showing().level == 0


def test_unplugged_during_a_blocking_read(pair: Pair) -> None:
    pair.usb.mute = True
    threading.Timer(0.1, pair.usb.unplug).start()
    fails(lambda: pair.driver.show(1), DeviceLost)
    pair.usb.clear()
    pair.usb.replug()
    pair.driver.open()
    pair.make_ready()


def test_stop_from_another_thread_while_a_read_blocks(pair: Pair) -> None:
    pair.usb.mute = True

    def show() -> None:
        with contextlib.suppress(InstrumentError):
            pair.driver.show(1)

    thread = threading.Thread(target=show)
    thread.start()
    time.sleep(0.1)
    pair.usb.clear()
    begun_s = time.monotonic()
    assert pair.driver.stop().stopped
    assert time.monotonic() - begun_s < BOUND_S
    thread.join()
    assert pair.box.showing().image is None


def test_replies_that_come_too_late_are_thrown_away(pair: Pair) -> None:
    pair.usb.mute = True
    fails(lambda: pair.driver.show(1), TimedOut)
    pair.usb.mute = False
    for _ in range(3):
        pair.make_ready()
        pair.driver.show(1)


@pytest.mark.usefixtures("light_box", "flash_box")
@pytest.mark.parametrize("which", ["light_on", "flash_on"])
def test_endless_replies_to_something_else(
    request: pytest.FixtureRequest, which: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = request.getfixturevalue(which)()
    link = driver._transport._link if which == "light_on" else driver._controller.link
    stale = {
        "light_on": bytes.fromhex("5a fe 04 04 00 00 00 00 60 01"),
        "flash_on": bytes.fromhex("40 fe 00 00") + bytes(60),
    }[which]
    monkeypatch.setattr(link, "read", lambda *_: stale)
    assert "earlier" in fails(driver.status, TimedOut).what
    monkeypatch.undo()
    assert driver.status().condition is ProjectorCondition.DARK


def test_close_while_it_is_silent_is_bounded_and_quiet(pair: Pair) -> None:
    pair.usb.mute = True
    begun_s = time.monotonic()
    pair.driver.close()
    assert time.monotonic() - begun_s < BOUND_S
    pair.usb.clear()
    pair.driver.open()
    assert pair.box.showing().level == 0


def test_close_after_unplugging(pair: Pair) -> None:
    pair.usb.unplug()
    pair.driver.close()
    fails(pair.driver.open, NotConnected)
    pair.usb.replug()
    pair.driver.open()
    pair.make_ready()


def test_open_that_fails_half_way_can_be_repeated(pair: Pair) -> None:
    pair.driver.close()
    pair.usb.stall_next()
    fails(pair.driver.open, DeviceFault)
    pair.driver.open()
    pair.make_ready()


def test_a_hot_led_driver_is_a_fault(light_box: lightcommander.LightCommander, light_on: On) -> None:
    driver = light_on()
    driver.load(IMAGES)
    driver.set_led(Led.RED, 0.3)
    driver.show(0)
    light_box.faults.overheat()
    status = driver.status()
    assert status.condition is ProjectorCondition.FAULT
    assert "too hot" in status.faults[0]
    fails(lambda: driver.show(1), DeviceFault)
    assert light_box.showing().level == 0


def test_an_led_fault(light_box: lightcommander.LightCommander, light_on: On) -> None:
    driver = light_on()
    driver.load(IMAGES)
    light_box.faults.led = "red"
    fails(lambda: driver.set_led(Led.RED, 0.3), DeviceFault)
    assert driver.status().faults
    light_box.faults.led = None
    driver.set_led(Led.RED, 0.3)
    driver.show(0)
    assert light_box.showing().led == "red"


def test_a_refusal_of_the_controller(flash_box: dlpc350.Dlpc350, flash_on: On) -> None:
    driver = flash_on()
    driver.set_led(Led.RED, 0.3)
    flash_box.faults.refuse_next()
    assert "refuses command 1A24" in fails(lambda: driver.show(0), Refused).what
    assert flash_box.showing().level == 0
    driver.set_led(Led.RED, 0.3)
    driver.show(0)


def test_an_aborted_sequence(flash_box: dlpc350.Dlpc350, flash_on: On) -> None:
    driver = flash_on()
    driver.set_led(Led.RED, 0.3)
    driver.order(PatternSequence((0, 1), exposure_us=20_000))
    driver.repeat()
    flash_box.faults.abort_sequence()
    status = driver.status()
    assert status.condition is ProjectorCondition.FAULT
    assert status.faults == ("an aborted sequence",)


@pytest.mark.usefixtures("light_box")
def test_another_program_that_holds_the_box(light_on: On) -> None:
    first, second = light_on(), light_on(opened=False)
    assert "another program" in fails(second.open, NotConnected).what
    first.close()
    second.open()


def test_two_boxes_are_told_apart_by_their_serial_numbers(
    bus: Any, clock: Any, light_box: lightcommander.LightCommander, light_on: On
) -> None:
    other = lightcommander.LightCommander(clock, serial_number="SIM-OTHER")
    bus.add(other)
    driver = light_on(serial_number="SIM-OTHER")
    driver.load(IMAGES)
    driver.set_led(Led.RED, 0.3)
    driver.show(1)
    assert np.array_equal(other.showing().image, IMAGES[1])
    assert light_box.showing().image is None
    nobody = light_on(opened=False, serial_number="SIM-NOBODY")
    assert "SIM-NOBODY" in fails(nobody.open, NotConnected).what
    other.close()


def test_nothing_on_the_bus(light_on: On, flash_on: On) -> None:
    assert "fff0:51ac" in fails(light_on(opened=False).open, NotConnected).what
    assert "0451:6401" in fails(flash_on(opened=False).open, NotConnected).what


@pytest.mark.parametrize(
    "backend", ["nothing", "no.such.module:f", "usb.core:nothing", "usb.core:find", "pathlib:Path"]
)
def test_a_backend_that_is_none(flash_on: On, backend: str) -> None:
    driver = flash_on(opened=False, backend=backend, backend_argument="x")
    error = fails(driver.open, ConfigurationError)
    assert isinstance(error, ConfigurationError)
    assert error.location == ("backend",)


def test_a_machine_without_libusb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: None)
    driver = make("projector", "dlpc350", "projector1", {"led_driver_inverts": False})
    assert "libusb-1.0-0" in fails(driver.open, ConfigurationError).remedy


def test_nothing_stays_behind(pair: Pair, leftovers: Callable[[], tuple[int, int]]) -> None:
    pair.driver.close()

    def settled() -> tuple[int, int]:
        # The bus's side of a connection ends a moment after the driver's.
        found = leftovers()
        for _ in range(50):
            time.sleep(0.02)
            found = min(found, leftovers())
        return found

    before = settled()
    for _ in range(3):
        pair.driver.open()
        pair.make_ready()
        pair.usb.stall_next()
        fails(lambda: pair.driver.show(1), DeviceFault)
        pair.usb.unplug()
        fails(lambda: pair.driver.show(1), DeviceLost, Refused)
        pair.usb.replug()
        pair.driver.close()
    assert settled() == before
