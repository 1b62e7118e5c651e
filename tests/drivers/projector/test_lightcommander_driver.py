"""The LightCommander's driver on the simulated box: what it shows, loads, refuses."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError, NotConnected, Refused
from drivers.projector.lightcommander import LightCommander
from drivers.protocols import Led, PatternSequence, Projector, ProjectorCondition, SyncOutput
from sims.projector import lightcommander

On = Callable[..., LightCommander]
Box = lightcommander.LightCommander

IMAGES = np.random.default_rng(3).integers(0, 256, (3, 768, 1024), np.uint8)
TWENTY_MS = PatternSequence((0, 1, 2), exposure_us=20_000)


@pytest.fixture
def lit(light_box: Box, light_on: On) -> LightCommander:
    """A driver with three patterns, their order, and infrared light."""
    driver = light_on()
    driver.load(IMAGES)
    driver.set_led(Led.INFRARED, 0.5)
    driver.order(TWENTY_MS)
    assert light_box.showing().image is None
    return driver


def wait_until(condition: Callable[[], bool], within_s: float = 30.0) -> None:
    give_up_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.005)


def test_it_is_a_projector_and_open_leaves_it_dark(light_box: Box, light_on: On) -> None:
    driver = light_on(opened=False)
    assert isinstance(driver, Projector)
    assert driver.status().condition is ProjectorCondition.CLOSED
    driver.open()
    assert driver.status().condition is ProjectorCondition.DARK
    assert light_box.showing().image is None
    assert driver.capabilities().leds == tuple(Led)
    assert driver.capabilities().pattern_limit == 120


def test_show_returns_when_the_pattern_s_light_is_there(light_box: Box, lit: LightCommander) -> None:
    for index in (1, 0, 2):
        lit.show(index)
        shown = light_box.showing()
        assert np.array_equal(shown.image, IMAGES[index])
        assert shown[1:] == ("infrared", 0.5)
        assert lit.status().pattern_index == index


def test_steps_follow_the_order_and_end_dark(light_box: Box, lit: LightCommander) -> None:
    lit.order(PatternSequence((2, 0, 2), exposure_us=20_000))
    for expected in (2, 0, 2):
        assert lit.step() == expected
        assert np.array_equal(light_box.showing().image, IMAGES[expected])
    assert lit.step() is None
    assert light_box.showing().image is None
    assert lit.step() == 2


def test_a_pattern_shown_in_between_does_not_disturb_the_order(light_box: Box, lit: LightCommander) -> None:
    assert lit.step() == 0
    lit.show(2)
    assert lit.step() == 1
    assert np.array_equal(light_box.showing().image, IMAGES[1])


def test_a_single_pass_gives_one_edge_a_pattern_and_ends_dark(light_box: Box, lit: LightCommander) -> None:
    edges: list[float] = []
    light_box.on_sync(edges.append, 1)
    lit.configure_sync(SyncOutput(enabled=True, output=1, delay_us=300))
    lit.run_once()
    assert lit.status().condition is ProjectorCondition.RUNNING
    wait_until(lambda: lit.status().condition is ProjectorCondition.DARK)
    assert np.diff(edges) == pytest.approx([0.025, 0.025], abs=1e-6)
    assert light_box.showing().image is None
    lit.configure_sync(SyncOutput(enabled=False, output=1))
    lit.run_once()
    wait_until(lambda: lit.status().condition is ProjectorCondition.DARK)
    assert len(edges) == 3


def test_repeat_goes_on_until_stop(light_box: Box, lit: LightCommander) -> None:
    lit.repeat()
    time.sleep(0.2)
    assert lit.status().condition is ProjectorCondition.RUNNING
    with pytest.raises(Refused, match="a sequence is running"):
        lit.order(TWENTY_MS)
    with pytest.raises(Refused, match="a sequence is running"):
        lit.load(IMAGES)
    assert lit.stop().stopped
    assert light_box.showing().image is None
    assert lit.status().condition is ProjectorCondition.DARK
    lit.show(0)
    assert np.array_equal(light_box.showing().image, IMAGES[0])


def test_the_times_in_force_are_those_of_the_sequence_file(light_on: On, light_box: Box, compiled) -> None:
    driver = light_on(compiled(16_660, 50_000), compiled(16_660, 16_667), compiled(500, 1000, 1))
    driver.load(IMAGES)
    taken = driver.order(PatternSequence((0,), exposure_us=16_667))
    assert (taken.exposure_us, taken.period_us) == (16_660, pytest.approx(16_667, rel=1e-5))
    taken = driver.order(PatternSequence((0,), exposure_us=16_667, period_us=50_000))
    assert taken.period_us == pytest.approx(50_000)
    driver.set_led(Led.GREEN, 0.1)
    driver.order(PatternSequence((1,), exposure_us=500, bits=1))
    driver.show(1)
    assert np.array_equal(light_box.showing().image, (IMAGES[1] >> 7) * 255)
    assert light_box.showing().led == "green"


@pytest.mark.parametrize(
    ("sequence", "remedy"),
    [
        (PatternSequence((0,), exposure_us=20_500), "20000 us every 25000 us at 8 bits"),
        (PatternSequence((0,), exposure_us=20_000, period_us=30_000), "compile one"),
        (PatternSequence((0,), exposure_us=20_000, bits=1), "compile one"),
        (PatternSequence((0,), exposure_us=1_428), "at least 1428.6 us"),
        (PatternSequence((0,), exposure_us=199, bits=1), "at least 200 us"),
        (PatternSequence((), exposure_us=20_000), "at least one"),
        (PatternSequence((3,), exposure_us=20_000), "0 to 2 are there"),
        (PatternSequence((-1,), exposure_us=20_000), "0 to 2 are there"),
        (PatternSequence((0,), exposure_us=20_000, bits=9), "1 to 8"),
        (PatternSequence((0,), exposure_us=20_000, bits=0), "1 to 8"),
        (PatternSequence((0,), exposure_us=float("nan")), "positive"),
        (PatternSequence((0,), exposure_us=20_000, period_us=19_000), "at least the exposure"),
    ],
)
def test_an_order_that_cannot_be_kept_is_refused_and_the_light_stays(
    light_box: Box, lit: LightCommander, sequence: PatternSequence, remedy: str
) -> None:
    with pytest.raises(Refused) as caught:
        lit.order(sequence)
    assert remedy in caught.value.remedy
    assert lit.status().led is Led.INFRARED
    lit.order(TWENTY_MS)
    lit.show(0)
    assert np.array_equal(light_box.showing().image, IMAGES[0])


def test_the_sequence_must_light_the_led(light_on: On, light_box: Box, compiled) -> None:
    driver = light_on(compiled(20_000, 25_000, 8, "red"), compiled(20_000, 25_000, 8, "green", "infrared"))
    driver.load(IMAGES)
    driver.set_led(Led.RED, 0.2)
    driver.order(TWENTY_MS)
    driver.show(0)
    assert light_box.showing()[1:] == ("red", pytest.approx(0.2))
    driver.set_led(Led.INFRARED, 0.3)
    shown = light_box.showing()
    assert np.array_equal(shown.image, IMAGES[0])
    assert shown[1:] == ("infrared", pytest.approx(0.3))
    with pytest.raises(Refused, match="no sequence file lights blue"):
        driver.set_led(Led.BLUE, 0.3)


@pytest.mark.parametrize("intensity", [0.601, 1.0, -0.1, float("nan"), float("inf")])
def test_more_than_sixty_per_cent_is_refused(light_box: Box, lit: LightCommander, intensity: float) -> None:
    with pytest.raises(Refused, match="LED intensity"):
        lit.set_led(Led.INFRARED, intensity)
    lit.show(0)
    assert light_box.showing().level == 0.5


def test_one_led_at_a_time_and_zero_is_off(light_box: Box, lit: LightCommander) -> None:
    lit.show(0)
    for led in (Led.RED, Led.GREEN, Led.BLUE, Led.INFRARED):
        lit.set_led(led, 0.6)
        assert light_box.showing()[1:] == (led, 0.6)
        assert lit.status().led is led
    lit.set_led(Led.INFRARED, 0.0)
    assert light_box.showing().level == 0.0
    assert lit.status().led is None


def test_only_planes_that_changed_are_sent(
    light_box: Box, lit: LightCommander, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[int] = []
    call = lit._transport.call

    def counting(operation: str, **values: object) -> object:
        if operation == "DLP_Img_DownloadBitplanePatternToExtMem":
            sent.append(int(str(values["plane"])))
        return call(operation, **values)  # type: ignore[arg-type]

    monkeypatch.setattr(lit._transport, "call", counting)
    lit.load(IMAGES)
    assert sent == []
    changed = IMAGES.copy()
    changed[1] ^= 0b100
    lit.load(changed)
    assert sent == [8 + 2]
    lit.show(1)
    assert np.array_equal(light_box.showing().image, changed[1])


@pytest.mark.usefixtures("light_box")
def test_the_memory_holds_120_images(light_on: On) -> None:
    driver = light_on()
    with pytest.raises(Refused, match="121 patterns"):
        driver.load(np.zeros((121, 768, 1024), np.uint8))
    assert driver.capabilities().pattern_limit == 120
    with pytest.raises(Refused, match="do not fit"):
        driver.load(np.zeros((1, 1024, 768), np.uint8))


def test_parked_mirrors_show_nothing(light_box: Box, lit: LightCommander) -> None:
    lit.show(0)
    lit.park()
    assert light_box.showing()[1:] == ("none", 0.0)
    assert lit.status().condition is ProjectorCondition.PARKED
    with pytest.raises(Refused, match="parked"):
        lit.show(0)
    lit.unpark()
    lit.set_led(Led.RED, 0.1)
    lit.show(0)
    assert light_box.showing().led == "red"


def test_close_turns_the_light_off_and_open_works_again(light_box: Box, lit: LightCommander) -> None:
    lit.show(0)
    lit.close()
    lit.close()
    assert light_box.showing().level == 0.0
    with pytest.raises(NotConnected, match="not open"):
        lit.show(0)
    assert lit.stop().stopped
    lit.open()
    with pytest.raises(Refused, match="not loaded"):
        lit.show(0)


def test_stop_ends_a_load_from_another_thread(light_box: Box, lit: LightCommander) -> None:
    many = np.random.default_rng(1).integers(0, 256, (60, 768, 1024), np.uint8)
    first_new = 8 * len(IMAGES)
    before = light_box._box.planes[first_new]

    def stop_under_way() -> None:
        wait_until(lambda: light_box._box.planes[first_new] is not before)
        lit.stop()

    stopper = threading.Thread(target=stop_under_way)
    stopper.start()
    with pytest.raises(Refused, match="stopped"):
        lit.load(many)
    stopper.join()
    assert light_box._box.planes[8 * len(many) - 1] is before
    with pytest.raises(Refused, match="not loaded"):
        lit.show(0)
    lit.load(IMAGES)
    lit.show(2)
    assert np.array_equal(light_box.showing().image, IMAGES[2])


def test_a_second_operation_at_the_same_time_is_refused(light_box: Box, lit: LightCommander) -> None:
    many = np.random.default_rng(2).integers(0, 256, (60, 768, 1024), np.uint8)
    first_new = 8 * len(IMAGES)
    before = light_box._box.planes[first_new]
    loading = threading.Thread(target=lit.load, args=(many,))
    loading.start()
    wait_until(lambda: light_box._box.planes[first_new] is not before)
    with pytest.raises(Refused, match="another operation"):
        lit.show(0)
    assert lit.status().condition is ProjectorCondition.DARK
    loading.join()


@pytest.mark.usefixtures("light_box")
def test_without_an_order_there_is_no_step(light_on: On) -> None:
    driver = light_on()
    driver.load(IMAGES)
    for operation in (driver.step, driver.run_once, driver.repeat):
        with pytest.raises(Refused, match="no order"):
            operation()


@pytest.mark.usefixtures("light_box")
def test_a_head_that_lies_about_its_words_is_found(light_on: On, compiled) -> None:
    path = Path(compiled(20_000, 25_000))
    path.write_text(path.read_text().replace("20000 usec", "10000 usec").replace("0.80000", "0.40000"))
    driver = light_on(str(path))
    driver.load(IMAGES)
    with pytest.raises(ConfigurationError, match="says 10000 us and 8 bits, the box 20000"):
        driver.order(PatternSequence((0,), exposure_us=10_000))
