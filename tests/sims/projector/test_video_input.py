"""A virtual screen taken as a projector's video input, drawn on by a plain X client."""

import contextlib
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from Xlib import X
from Xlib.display import Display
from Xlib.error import ConnectionClosedError

from sims.clock import Clock
from sims.errors import SimulationError
from sims.projector.player import NOTHING, Shown
from sims.projector.video_input import VideoProjector, grey
from tests.small_world import until

DELAY_S = 0.2
PATTERN = np.tile(np.arange(1024) // 4, (768, 1)).astype(np.uint8)


@contextlib.contextmanager
def virtual_screen(*number: str) -> Iterator[str]:
    """Run a virtual screen of 1280 x 800 with a number, or one that the server chooses."""
    xvfb = shutil.which("Xvfb")
    if xvfb is None:
        pytest.skip("no Xvfb: install Debian's package xvfb")
    command = [xvfb, *number, "-displayfd", "1", "-screen", "0", "1280x800x24", "-nolisten", "tcp", "-noreset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        try:
            yield f":{server.stdout.readline().strip()}"
        finally:
            server.terminate()


@pytest.fixture
def display() -> Iterator[str]:
    with virtual_screen() as name:
        yield name


class Window:
    """A window of 1024 x 768 without a frame."""

    def __init__(self, display: str, left: int = 0, top: int = 0) -> None:
        self._display = Display(display)
        screen = self._display.screen()
        self._window = screen.root.create_window(
            left, top, 1024, 768, 0, screen.root_depth, X.InputOutput, override_redirect=True
        )
        self._window.map()
        self._graphics = self._window.create_gc()
        self._display.sync()

    def draw(self, image: np.ndarray) -> None:
        pixels = np.zeros((768, 1024, 4), np.uint8)
        pixels[..., :3] = image if image.ndim == 3 else image[..., None]
        for row in range(0, 768, 32):  # a request of the protocol holds 256 kB
            part = pixels[row : row + 32].tobytes()
            self._window.put_image(self._graphics, 0, row, 1024, 32, X.ZPixmap, 24, 0, part)
        self._display.sync()

    def close(self) -> None:
        self._display.close()


def wait_for(projector: VideoProjector, image: np.ndarray) -> float:
    """Return the time at which the projector is first seen to show an image."""
    give_up_s = time.monotonic() + 30
    while time.monotonic() < give_up_s:
        shown = projector.showing()
        if shown.image is not None and np.array_equal(shown.image, image):
            return time.monotonic()
        time.sleep(0.002)
    raise AssertionError("the image was never shown")


def test_a_window_is_projected_after_the_delay(display: str) -> None:
    clock = Clock()
    projector = VideoProjector(clock, display, delay_s=DELAY_S)
    window = Window(display)
    projector.set_light("infrared", 0.4)
    window.draw(PATTERN)
    wait_for(projector, PATTERN)
    begun_s = clock.now()
    window.draw(255 - PATTERN)
    drawn_s = clock.now()
    wait_for(projector, 255 - PATTERN)
    seen_s = clock.now()
    # It came no sooner than the delay allows.
    assert seen_s - begun_s >= DELAY_S
    assert projector.showing()[1:] == ("infrared", 0.4)
    # It is told when: the last that shows the picture of before ends between the drawing and the seeing.
    told = list(projector.intervals(begun_s, seen_s))
    before = [end_s for _, end_s, shown in told if np.array_equal(shown.image, PATTERN)]
    assert begun_s + DELAY_S <= before[-1] <= seen_s
    assert before[-1] - drawn_s < 10 * DELAY_S
    assert np.array_equal(told[-1][2].image, 255 - PATTERN)
    projector.set_light("infrared", 0)
    assert projector.showing() == NOTHING
    window.close()
    projector.close()


def test_the_region_may_be_anywhere_on_the_screen(display: str) -> None:
    projector = VideoProjector(Clock(), display, left_px=256, top_px=32, delay_s=0)
    projector.set_light("green", 1.0)
    window = Window(display, 256, 32)
    window.draw(PATTERN)
    wait_for(projector, PATTERN)
    window.close()
    projector.close()


def test_colours_are_averaged() -> None:
    pixels = np.zeros((768, 1024, 4), np.uint8)
    pixels[0, 0] = (30, 60, 90, 255)
    pixels[0, 1] = (255, 255, 255, 0)
    assert grey(pixels.tobytes())[0, :3].tolist() == [60, 255, 0]


def test_without_a_signal_the_picture_is_black(display: str) -> None:
    projector = VideoProjector(Clock(), display, delay_s=0)
    projector.set_light("red", 0.5)
    window = Window(display)
    window.draw(PATTERN)
    wait_for(projector, PATTERN)
    projector.faults.no_signal = True
    until(lambda: projector.showing().image is None)
    assert projector.showing() == Shown(None, "red", 0.5)
    projector.faults.no_signal = False
    wait_for(projector, PATTERN)
    window.close()
    projector.close()


def test_a_screen_that_goes_away_is_black_until_it_is_back() -> None:
    # A number that no other test is given: it is wanted again.
    number = f":{1000 + os.getpid() % 30_000}"
    with virtual_screen(number) as display:
        VideoProjector(Clock(), display).close()
    before = count()
    with virtual_screen(number) as display:
        projector = VideoProjector(Clock(), display, delay_s=0)
        projector.set_light("red", 0.5)
        window = Window(display)
        window.draw(PATTERN)
        wait_for(projector, PATTERN)
        with contextlib.suppress(ConnectionClosedError):
            window.close()
    until(lambda: projector.showing().image is None)
    with virtual_screen(display) as display_again:
        assert display_again == display
        window = Window(display)
        window.draw(255 - PATTERN)
        wait_for(projector, 255 - PATTERN)
        window.close()
        projector.close()
    assert count() == before


def test_a_display_that_is_not_there_or_too_small_is_named(display: str) -> None:
    with pytest.raises(SimulationError, match=r"no X display ':1234'.*xvfb"):
        VideoProjector(Clock(), ":1234")
    with pytest.raises(SimulationError, match="holds no 1024 x 768 pixels"):
        VideoProjector(Clock(), display, left_px=512)


def count() -> tuple[int, int]:
    return threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))


def test_nothing_stays_behind(display: str) -> None:
    VideoProjector(Clock(), display).close()
    before = count()
    for _ in range(3):
        VideoProjector(Clock(), display).close()
    assert count() == before
