"""Patterns in a real window on a virtual screen, compared with its screenshot pixel by pixel."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mss
import numpy as np
import pytest

from drivers.errors import ConfigurationError, DeviceLost, InstrumentError, NotConnected, Refused, TimedOut, Unsupported
from drivers.projector.video import VideoProjector
from drivers.protocols import Led, PatternSequence, Projector, ProjectorCondition, SyncOutput
from drivers.registry import make
from sims.clock import Clock
from sims.projector import video_input
from tests.small_world import until

PATTERNS = np.random.default_rng(11).integers(0, 256, (3, 768, 1024), np.uint8)
BLACK = np.zeros((768, 1024), np.uint8)
# Every bound here is a few seconds: it has ended by then on any machine, and what hangs has not.
HANG_S = 40.0


@contextmanager
def virtual_screen(size: str = "1024x768x24", *more: str) -> Iterator[str]:
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        pytest.skip("no Xvfb: install Debian's package xvfb")
    command = [xvfb, "-displayfd", "1", "-screen", "0", size, *more, "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        try:
            yield f":{server.stdout.readline().strip()}"
        finally:
            server.terminate()


@pytest.fixture(scope="module")
def screen() -> Iterator[str]:
    with virtual_screen() as name:
        yield name


def video(x_display: str | None, **settings) -> VideoProjector:
    values = {"x_display": x_display, "display_delay_s": 0.0}
    driver = make("projector", "video", "projector1", values | settings)
    assert isinstance(driver, VideoProjector)
    return driver


@pytest.fixture
def driver(screen: str) -> Iterator[VideoProjector]:
    made = video(screen)
    made.open()
    yield made
    made.close()


def seen(display: str, left: int = 0, top: int = 0) -> np.ndarray:
    with mss.MSS(display=display) as grabber:
        shot = grabber.grab({"left": left, "top": top, "width": 1024, "height": 768})
    colours = np.frombuffer(shot.raw, np.uint8).reshape(768, 1024, 4)[..., :3]
    assert np.all(colours == colours[..., :1])
    return colours[..., 0]


def test_the_window_shows_the_pattern_pixel_by_pixel(screen: str, driver: VideoProjector) -> None:
    assert isinstance(driver, Projector)
    assert np.array_equal(seen(screen), BLACK)
    driver.load(PATTERNS)
    for index in (2, 0, 1):
        driver.show(index)
        assert np.array_equal(seen(screen), PATTERNS[index])
        assert driver.status().pattern_index == index
    assert driver.stop().stopped
    assert np.array_equal(seen(screen), BLACK)
    assert driver.status().condition is ProjectorCondition.DARK


def test_steps_and_their_end(screen: str, driver: VideoProjector) -> None:
    driver.load(PATTERNS)
    driver.order(PatternSequence((1, 2), exposure_us=100_000))
    assert driver.step() == 1
    assert np.array_equal(seen(screen), PATTERNS[1])
    assert driver.step() == 2
    assert driver.step() is None
    assert np.array_equal(seen(screen), BLACK)


def test_times_are_whole_video_frames(driver: VideoProjector) -> None:
    driver.load(PATTERNS)
    taken = driver.order(PatternSequence((0,), exposure_us=40_000, period_us=90_000))
    assert taken.exposure_us == pytest.approx(2e6 / 60)
    assert taken.period_us == pytest.approx(5e6 / 60)
    for sequence, remedy in (
        (PatternSequence((0,), exposure_us=8_000), "at least 16666.7 us"),
        (PatternSequence((0,), exposure_us=40_000, bits=1), "give 8"),
        (PatternSequence((3,), exposure_us=40_000), "0 to 2"),
    ):
        with pytest.raises(Refused) as caught:
            driver.order(sequence)
        assert remedy in caught.value.remedy


def names_seen(display: str, driver: VideoProjector) -> Iterator[str]:
    """Name what is on the screen, one after the other, until the driver says that it is dark."""
    names = {pattern.tobytes(): str(index) for index, pattern in enumerate(PATTERNS)} | {BLACK.tobytes(): "dark"}
    last = ""
    running = True
    while running:
        running = driver.status().condition is ProjectorCondition.RUNNING
        name = names[seen(display).tobytes()]
        if name != last:
            yield name
        last = name


def test_a_run_shows_every_pattern_once_and_ends_dark(screen: str, driver: VideoProjector) -> None:
    driver.load(PATTERNS)
    driver.order(PatternSequence((0, 1, 2), exposure_us=700_000, period_us=1_400_000))
    driver.run_once()
    assert list(names_seen(screen, driver)) == ["0", "dark", "1", "dark", "2", "dark"]
    assert driver.status().condition is ProjectorCondition.DARK
    driver.repeat()
    time.sleep(1.0)
    assert driver.status().condition is ProjectorCondition.RUNNING
    with pytest.raises(Refused, match="running"):
        driver.load(PATTERNS)
    driver.stop()
    assert np.array_equal(seen(screen), BLACK)


def test_show_waits_for_the_display(screen: str) -> None:
    driver = video(screen, display_delay_s=0.3)
    driver.open()
    driver.load(PATTERNS)
    begun_s = time.monotonic()
    driver.show(0)
    assert time.monotonic() - begun_s >= 0.3
    driver.close()


def test_patterns_may_lie_anywhere_on_a_larger_display() -> None:
    with virtual_screen("1280x800x24") as display:
        driver = video(display, corner_px=(100, 20))
        driver.open()
        driver.load(PATTERNS)
        driver.show(1)
        assert np.array_equal(seen(display, 100, 20), PATTERNS[1])
        driver.close()
        with pytest.raises(ConfigurationError, match="1280 x 800 pixels") as caught:
            video(display).open()
        assert "corner_px" in caught.value.remedy
        with pytest.raises(ConfigurationError, match=r"at \(300, 0\)"):
            video(display, corner_px=(300, 0)).open()


def test_displays_that_cannot_be_told_apart_are_refused() -> None:
    # Two X screens of one server lie at the same place.
    with (
        virtual_screen("640x480x24", "-screen", "1", "1024x768x24") as display,
        pytest.raises(ConfigurationError, match="display 1 cannot be told from another"),
    ):
        video(display, display=1).open()


def test_the_simulated_projector_shows_the_window(screen: str, driver: VideoProjector) -> None:
    clock = Clock()
    projector = video_input.VideoProjector(clock, screen, delay_s=0.05)
    projector.set_light("infrared", 0.5)
    driver.load(PATTERNS)
    driver.show(1)
    until(lambda: np.array_equal(projector.showing().image, PATTERNS[1]))
    assert projector.showing().led == "infrared"
    projector.close()
    clock.close()


def test_what_a_video_signal_cannot_do_is_unsupported(driver: VideoProjector) -> None:
    capabilities = driver.capabilities()
    assert (capabilities.leds, capabilities.has_sync, capabilities.can_park) == ((), False, False)
    for operation in (
        lambda: driver.set_led(Led.RED, 0.1),
        lambda: driver.configure_sync(SyncOutput(enabled=True)),
        driver.park,
        driver.unpark,
    ):
        with pytest.raises(Unsupported):
            operation()


@pytest.mark.parametrize(
    ("settings", "error", "what"),
    [
        ({"x_display": ":9876"}, NotConnected, "no display"),
        ({"display": 3}, NotConnected, "no display 3"),
        ({"size_px": (912, 1140)}, ConfigurationError, "1024 x 768 pixels"),
    ],
)
def test_a_wrong_display(screen: str, settings, error: type[InstrumentError], what: str) -> None:
    driver = make("projector", "video", "projector1", {"x_display": screen} | settings)
    with pytest.raises(error) as caught:
        driver.open()
    assert what in caught.value.what


def test_no_display_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NotConnected, match="display"):
        video(None).open()
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.raises(NotConnected, match="no display that anyone sees"):
        video(None).open()


def fails_in_time(operation: Callable[[], object], error: type[InstrumentError]) -> None:
    begun_s = time.monotonic()
    with pytest.raises(error):
        operation()
    assert time.monotonic() - begun_s < HANG_S


def test_a_display_that_goes_away_and_comes_back() -> None:
    with virtual_screen() as display:
        driver = video(display)
        driver.open()
        driver.load(PATTERNS)
        driver.show(0)
    fails_in_time(lambda: driver.show(1), DeviceLost)
    fails_in_time(driver.status, NotConnected)
    with virtual_screen() as display:
        driver.close()
        driver = video(display)
        driver.open()
        driver.load(PATTERNS)
        driver.show(1)
        assert np.array_equal(seen(display), PATTERNS[1])
        driver.close()


def test_a_window_that_dies_or_hangs_is_opened_again(
    screen: str, driver: VideoProjector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.projector.screen.CALL_LIMIT_S", 2.0)
    for number, error in ((signal.SIGKILL, DeviceLost), (signal.SIGSTOP, TimedOut)):
        driver.load(PATTERNS)
        driver.show(0)
        child = driver._screen._child
        assert child is not None
        os.kill(child._process.pid, number)
        fails_in_time(lambda: driver.show(1), error)
        driver.load(PATTERNS)
        driver.show(1)
        assert np.array_equal(seen(screen), PATTERNS[1])


def test_nothing_stays_behind(screen: str, leftovers: Callable[[], object]) -> None:
    driver = video(screen)
    before = leftovers()
    for _ in range(2):
        driver.open()
        child = driver._screen._child
        assert child is not None
        driver.close()
        assert child._process.returncode == 0
    assert leftovers() == before
