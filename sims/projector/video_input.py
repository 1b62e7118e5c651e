"""A projector whose video input is a screen of an X display: a window that shows there is projected.

The display may be a real one or a virtual one (Xvfb, Debian's package xvfb). It is sampled at the refresh
rate of the video signal, in real time, and what was sampled appears `delay_s` later: that delay, of cable,
scaler and mirrors, is what a rig has to measure. Frames that do not change are not kept twice.
"""

import contextlib
import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from itertools import pairwise

import mss
import numpy as np
from mss.exception import ScreenShotError

from sims.clock import WorldClock
from sims.errors import SimulationError
from sims.projector.bitplanes import COLUMNS, ROWS
from sims.projector.player import DARK, NOTHING, Image, Light, Shown

KEPT_FRAMES = 128
RECONNECTS_AFTER_S = 0.5


class Screen:
    """A region of an X display.

    Parameters
    ----------
    display
        Name of the display, as in ":99".
    left_px, top_px
        Corner of the region of 1024 x 768 pixels.

    Raises
    ------
    SimulationError
        If there is no such display or it is too small.
    """

    def __init__(self, display: str, left_px: int = 0, top_px: int = 0) -> None:
        self._region = {"left": left_px, "top": top_px, "width": COLUMNS, "height": ROWS}
        try:
            self._grabber = mss.MSS(display=display)
        except ScreenShotError as error:
            raise SimulationError(
                f"no X display {display!r}: name one that runs, or start a virtual one (Debian package xvfb)"
            ) from error
        try:
            self.grab()
        except SimulationError as error:
            self._grabber.close()
            raise SimulationError(
                f"display {display!r} holds no {COLUMNS} x {ROWS} pixels at ({left_px}, {top_px})"
            ) from error

    def grab(self) -> bytes:
        """Return the region as it is now, four bytes a pixel (blue, green, red, nothing).

        Raises
        ------
        SimulationError
            If the display has gone.
        """
        try:
            return bytes(self._grabber.grab(self._region).raw)
        except (ScreenShotError, AssertionError) as error:
            # A server that went away is an assertion that fails in the library.
            raise SimulationError("the X display has gone") from error

    def close(self) -> None:
        """Disconnect."""
        with contextlib.suppress(ScreenShotError):
            self._grabber.close()


def grey(pixels: bytes) -> Image:
    """Return the mean of the three colours of a grabbed region, shape (768, 1024)."""
    colours = np.frombuffer(pixels, np.uint8).reshape(ROWS, COLUMNS, 4)
    total = colours[..., 0].astype(np.uint16) + colours[..., 1] + colours[..., 2]
    image: Image = ((total + 1) // 3).astype(np.uint8)
    image.setflags(write=False)
    return image


class VideoFaults:
    """Faults of the video line, switchable from any thread: `no_signal` turns the picture black."""

    def __init__(self) -> None:
        self.no_signal = False


class VideoProjector:
    """A projector with a video input and an LED that is set by hand.

    Parameters
    ----------
    clock
        The clock of the world. The screen is sampled in real time, so a clock that runs faster makes the
        sampling coarser in the world's time.
    display
        Name of the X display.
    left_px, top_px
        Corner on it of the region of 1024 x 768 pixels that is the projector's.
    delay_s
        From the screen to the light.
    refresh_hz
        How often the screen is looked at.

    Raises
    ------
    SimulationError
        If there is no such display or it is too small.
    """

    def __init__(
        self,
        clock: WorldClock,
        display: str,
        *,
        left_px: int = 0,
        top_px: int = 0,
        delay_s: float = 0.03,
        refresh_hz: float = 60.0,
    ) -> None:
        self._clock = clock
        self._display = display
        self._corner = (left_px, top_px)
        self._period_s = 1.0 / refresh_hz
        self.delay_s = delay_s
        self.faults = VideoFaults()
        self._lock = threading.Lock()
        self._frames: deque[tuple[float, Image | None]] = deque(maxlen=KEPT_FRAMES)
        self._lights = deque([Light(float("-inf"))], maxlen=KEPT_FRAMES)
        self._ended = threading.Event()
        screen = Screen(display, left_px, top_px)
        pixels = screen.grab()
        self._frames.append((clock.now(), grey(pixels)))
        self._thread = threading.Thread(target=self._run, args=(screen, pixels), name="video-input", daemon=True)
        self._thread.start()

    def set_light(self, led: str, level: float) -> None:
        """Set the LED, as a person would at the box; level 0 is off."""
        with self._lock:
            self._lights.append(Light(self._clock.now(), {led: level} if level > 0 else {}))

    def showing(self) -> Shown:
        """Return what is shown now."""
        return self.shown_at(self._clock.now())

    def shown_at(self, time_s: float) -> Shown:
        """Return what is shown at a time that is not long over."""
        with self._lock:
            lights, frames = list(self._lights), list(self._frames)
        light = lights[max(0, bisect_right(lights, time_s, key=lambda light: light.start_s) - 1)]
        if not light.levels:
            return NOTHING
        (led, level), *_ = light.levels.items()
        seen = bisect_right(frames, time_s - self.delay_s, key=lambda frame: frame[0]) - 1
        image = frames[seen][1] if seen >= 0 else None
        return Shown(image, led if level > 0 else DARK, level)

    def intervals(self, start_s: float, end_s: float) -> list[tuple[float, float, Shown]]:
        """Return what is shown from `start_s` to `end_s`, as (start, end, shown) without gaps."""
        cuts = [start_s, *sorted(self._changes(start_s, end_s)), end_s]
        return [(from_s, to_s, self.shown_at((from_s + to_s) / 2)) for from_s, to_s in pairwise(cuts)]

    def _changes(self, start_s: float, end_s: float) -> Iterator[float]:
        with self._lock:
            lights, frames = list(self._lights), list(self._frames)
        times = {light.start_s for light in lights} | {time_s + self.delay_s for time_s, _ in frames}
        yield from (time_s for time_s in times if start_s < time_s < end_s)

    def close(self) -> None:
        """End the sampling."""
        self._ended.set()
        self._thread.join()

    def _run(self, screen: Screen | None, last: bytes) -> None:
        while not self._ended.wait(self._period_s if screen else RECONNECTS_AFTER_S):
            pixels = b""
            try:
                screen = screen or Screen(self._display, *self._corner)
                if not self.faults.no_signal:
                    pixels = screen.grab()
            except SimulationError:
                # A screen that went away is a pulled cable: black until it comes back.
                if screen:
                    screen.close()
                screen = None
            if pixels != last:
                last = pixels
                with self._lock:
                    self._frames.append((self._clock.now(), grey(pixels) if pixels else None))
        if screen:
            screen.close()
