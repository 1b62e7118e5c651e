"""The DLPC350's driver on the simulated controller."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import pytest

from drivers.errors import NotConnected, Refused, Unsupported
from drivers.projector.dlpc350 import Dlpc350
from drivers.protocols import Led, PatternSequence, Projector, ProjectorCondition, SyncOutput
from sims.projector import dlpc350

On = Callable[..., Dlpc350]
Box = dlpc350.Dlpc350

# Bits are counted from the lowest of green over red to blue.
CHANNELS = (1, 0, 2)


@pytest.fixture
def lit(flash_box: Box, flash_on: On) -> Dlpc350:
    driver = flash_on()
    driver.set_led(Led.GREEN, 0.5)
    assert flash_box.showing().led == "green"
    return driver


def wait_until(condition: Callable[[], bool], within_s: float = 30.0) -> None:
    give_up_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.005)


def test_it_is_a_projector_and_open_leaves_it_dark(flash_box: Box, flash_on: On) -> None:
    driver = flash_on(opened=False)
    assert isinstance(driver, Projector)
    driver.open()
    assert flash_box.showing().level == 0
    assert driver.status().condition is ProjectorCondition.DARK
    assert driver.capabilities().leds == (Led.RED, Led.GREEN, Led.BLUE)
    assert not flash_box.kernel_driver
    driver.close()
    assert flash_box.kernel_driver


def test_patterns_of_the_flash_are_counted_through_its_images(flash_box: Box, lit: Dlpc350, flash) -> None:
    for index in (0, 1, 2, 3, 8):
        lit.show(index)
        time.sleep(0.005)
        shown = flash_box.showing()
        assert np.array_equal(shown.image, flash[index // 3][..., CHANNELS[index % 3]])
        assert shown[1:] == ("green", pytest.approx(127 / 255))
        assert lit.status().pattern_index == index
    with pytest.raises(Refused, match="pattern 9 is not loaded"):
        lit.show(9)


def test_loading_would_mean_flashing(lit: Dlpc350) -> None:
    assert not lit.capabilities().can_load
    with pytest.raises(Unsupported, match="flashing"):
        lit.load(np.zeros((1, 1140, 912), np.uint8))


@pytest.mark.parametrize("order", [(0, 1), (0, 3), (3, 0), (0, 3, 6), (6, 7, 0, 3), (0, 3, 0, 3)])
def test_a_sequence_over_several_images(flash_box: Box, lit: Dlpc350, flash, order: tuple[int, ...]) -> None:
    edges: list[float] = []
    flash_box.on_sync(edges.append)
    taken = lit.order(PatternSequence(order, exposure_us=100_000))
    assert (taken.exposure_us, taken.period_us) == (100_000, 100_000)
    lit.run_once()
    wait_until(lambda: lit.status().condition is ProjectorCondition.DARK)
    assert np.diff(edges) == pytest.approx([0.1] * (len(order) - 1), abs=1e-6)
    for edge_s, index in zip(edges, order, strict=True):
        shown = flash_box.player.shown_at(edge_s + 0.05)
        assert np.array_equal(shown.image, flash[index // 3][..., CHANNELS[index % 3]])


def test_two_images_repeated(flash_box: Box, lit: Dlpc350, flash) -> None:
    lit.order(PatternSequence((0, 3), exposure_us=50_000))
    edges: list[float] = []
    flash_box.on_sync(edges.append)
    lit.repeat()
    wait_until(lambda: len(edges) > 5)
    shown = [flash_box.player.shown_at(edge_s + 0.02).image for edge_s in edges[:5]]
    lit.stop()
    for image, number in zip(shown, (0, 1, 0, 1, 0), strict=True):
        assert np.array_equal(image, flash[number][..., 1])


def test_repeat_goes_on_until_stop(flash_box: Box, lit: Dlpc350) -> None:
    lit.order(PatternSequence((0, 1, 2), exposure_us=10_000, period_us=10_230))
    lit.repeat()
    time.sleep(0.1)
    assert lit.status().condition is ProjectorCondition.RUNNING
    with pytest.raises(Refused, match="running"):
        lit.order(PatternSequence((0,), exposure_us=10_000))
    assert lit.stop().stopped
    assert flash_box.showing().image is None
    assert lit.status().condition is ProjectorCondition.DARK


def test_steps(flash_box: Box, lit: Dlpc350, flash) -> None:
    lit.order(PatternSequence((4, 2), exposure_us=10_000))
    assert lit.step() == 4
    time.sleep(0.005)
    assert np.array_equal(flash_box.showing().image, flash[1][..., 0])
    assert lit.step() == 2
    assert lit.step() is None
    assert flash_box.showing().image is None


@pytest.mark.parametrize(
    ("sequence", "remedy"),
    [
        (PatternSequence((0,), exposure_us=8_332), "at least 8333 us"),
        (PatternSequence((0,), exposure_us=234, bits=1), "at least 235 us"),
        (PatternSequence((0,), exposure_us=10_000, period_us=10_229), "at least 10230 us"),
        (PatternSequence((9,), exposure_us=10_000), "0 to 8"),
        (PatternSequence((72,), exposure_us=10_000, bits=1), "0 to 71"),
        (PatternSequence((0,) * 129, exposure_us=10_000), "at most 128"),
        (PatternSequence((0, 3) * 33, exposure_us=10_000), "64 changes"),
    ],
)
def test_what_the_controller_cannot_keep_is_refused(lit: Dlpc350, sequence: PatternSequence, remedy: str) -> None:
    with pytest.raises(Refused) as caught:
        lit.order(sequence)
    assert remedy in caught.value.remedy
    assert lit.status().led is Led.GREEN


def test_the_intensity_is_capped_and_never_rounded_up(flash_box: Box, lit: Dlpc350) -> None:
    lit.show(0)
    lit.set_led(Led.RED, 0.6)
    assert flash_box.showing()[1:] == ("red", pytest.approx(153 / 255))
    with pytest.raises(Refused, match="intensity"):
        lit.set_led(Led.RED, 0.601)
    with pytest.raises(Unsupported, match="infrared"):
        lit.set_led(Led.INFRARED, 0.1)
    lit.set_led(Led.BLUE, 0.0)
    assert flash_box.showing().level == 0


def test_an_inverting_polarity_register_is_respected(flash_box: Box, flash_on: On) -> None:
    driver = flash_on()
    driver._controller.write(0x1A05, b"\1")
    driver.close()
    driver.open()
    driver.set_led(Led.RED, 0.2)
    driver.show(0)
    assert flash_box.showing()[1:] == ("red", pytest.approx(0.2))


@pytest.mark.usefixtures("flash_box")
@pytest.mark.parametrize(("board", "register", "current"), [(True, 0, 204), (True, 1, 51), (False, 1, 204)])
def test_the_board_and_the_register_may_invert(flash_on: On, board: bool, register: int, current: int) -> None:
    driver = flash_on(led_driver_inverts=board)
    driver._controller.write(0x1A05, bytes([register]))
    driver.close()
    driver.open()
    driver.set_led(Led.RED, 0.2)
    none = 0 if current == 51 else 255
    assert driver._controller.ask(0x0B01, 3) == bytes([current, none, none])


def test_it_is_woken_from_standby(flash_box: Box, lit: Dlpc350, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.projector.dlpc350.WAKES_WITHIN_S", 0.01)
    lit._controller.write(0x0200, b"\1")
    lit.close()
    lit.open()
    lit.set_led(Led.RED, 0.2)
    lit.show(0)
    assert flash_box.showing().led == "red"


def test_the_trigger_output(flash_box: Box, lit: Dlpc350) -> None:
    edges: list[float] = []
    flash_box.on_sync(edges.append)
    lit.configure_sync(SyncOutput(enabled=True, output=1, delay_us=-10.0))
    lit.configure_sync(SyncOutput(enabled=True, output=2, polarity="negative"))
    lit.order(PatternSequence((0, 1), exposure_us=50_000))
    lit.run_once()
    wait_until(lambda: len(edges) == 2)
    for sync, error in (
        (SyncOutput(enabled=True, delay_us=3.0), Refused),
        (SyncOutput(enabled=True, output=3), Unsupported),
        (SyncOutput(enabled=False), Unsupported),
    ):
        wait_until(lambda: lit.status().condition is ProjectorCondition.DARK)
        with pytest.raises(error):
            lit.configure_sync(sync)


def test_parked_mirrors_show_nothing(flash_box: Box, lit: Dlpc350) -> None:
    lit.show(0)
    lit.park()
    assert flash_box.showing().level == 0
    assert lit.status().condition is ProjectorCondition.PARKED
    with pytest.raises(Refused, match="parked"):
        lit.show(0)
    lit.unpark()
    assert lit.status().condition is ProjectorCondition.DARK


def test_close_turns_the_light_off(flash_box: Box, lit: Dlpc350) -> None:
    lit.show(0)
    lit.close()
    assert flash_box.showing().level == 0
    with pytest.raises(NotConnected, match="not open"):
        lit.show(0)


def test_stop_during_a_programme_leaves_it_dark(flash_box: Box, lit: Dlpc350) -> None:
    ended = threading.Event()

    def show() -> None:
        with suppress(Refused):
            while True:
                lit.show(0)
        ended.set()

    thread = threading.Thread(target=show)
    thread.start()
    time.sleep(0.1)
    for _ in range(20):
        lit.stop()
        if ended.wait(0.1):
            break
    thread.join()
    lit.stop()
    assert flash_box.showing().image is None
