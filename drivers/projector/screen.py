"""A window that covers the projector's video output; it lives in a process of its own.

SDL wants its own event loop, and a display that goes away ends the process that uses it.
"""

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.errors import DeviceLost, NotConnected, Refused, TimedOut
from drivers.projector.child import Child
from drivers.projector.source import Talking
from drivers.settings import Settings
from drivers.values import PatternSequence

CALL_LIMIT_S = 5.0
# More for each pattern that goes through the socket.
LOAD_LIMIT_S = 0.05
BITS = 8

Pixels = Annotated[int, Field(ge=1, le=16384)]
Place = Annotated[int, Field(ge=0, le=16384)]


class ScreenSettings(Settings):
    """A display and what the projector behind it takes.

    Attributes
    ----------
    display
        Number of the display, 0 for the first.
    x_display
        Name of the X server, as ``":0"``; none: the one of the environment.
    size_px
        (width, height) of the projector: one pixel of a pattern is one of the display.
    corner_px
        Where on the display the patterns lie; none: the display has exactly their size and is covered.
    refresh_hz
        Rate of the video signal: times are whole numbers of its frames.
    display_delay_s
        From the window to the light: cable, scaler, mirrors. To be measured; it is waited for after each pattern.
    """

    display: Annotated[int, Field(ge=0, le=15)] = 0
    x_display: str | None = None
    size_px: tuple[Pixels, Pixels] = (1024, 768)
    corner_px: tuple[Place, Place] | None = None
    refresh_hz: Annotated[float, Field(ge=1.0, le=1000.0)] = 60.0
    display_delay_s: Annotated[float, Field(ge=0.0, le=5.0)] = 0.1


class Screen:
    """A `drivers.projector.source.PatternSource` in a window.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    settings
        The display.
    talking
        Holds the line while the window's process is called.
    pause
        Waits, unless stopped.
    """

    def __init__(self, device: str, settings: ScreenSettings, talking: Talking, pause: Callable[[float], None]) -> None:
        self._device = device
        self._settings = settings
        self._talking = talking
        self._pause = pause
        self._child: Child | None = None
        self._count = 0
        self._order: tuple[int, ...] = ()
        self._frames = (1, 1)
        self.size_px = settings.size_px

    def open(self) -> None:
        """Open the window, dark.

        Raises
        ------
        NotConnected
            There is no such display.
        ConfigurationError
            The display has another size than the projector.
        """
        self.close()
        self._count, self._order = 0, ()
        child = Child(self._device, "drivers.projector.screen_process", self._settings.model_dump())
        try:
            child.greet()
        except (TimedOut, DeviceLost) as error:
            raise NotConnected(
                self._device, f"the window does not open: {error.what}", "name a display that runs, and its X server"
            ) from None
        self._child = child

    def close(self) -> None:
        """Close the window; never raises, may be repeated."""
        child, self._child = self._child, None
        if child is not None:
            child.end()

    @property
    def is_open(self) -> bool:
        """Whether the window's process is there, as far as is known."""
        return self._child is not None

    def count(self, _bits: int, /) -> int:
        """Tell how many patterns are loaded."""
        return self._count

    def load(self, patterns: NDArray[np.uint8]) -> None:
        """Hand the patterns to the window's process."""
        self._count, self._order = 0, ()
        limit_s = CALL_LIMIT_S + LOAD_LIMIT_S * len(patterns)
        with self._talking():
            self._call("load", patterns.tobytes(), timeout_s=limit_s, count=len(patterns))
        self._count = len(patterns)

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Set the sequence; its times become whole numbers of video frames.

        Raises
        ------
        Refused
            Fewer than 8 bits, or shorter than a video frame.
        """
        if sequence.bits != BITS:
            raise Refused(self._device, f"a video signal does not show {sequence.bits} bits", f"give {BITS}")
        frame_us = 1e6 / self._settings.refresh_hz
        lit = round(sequence.exposure_us / frame_us)
        if not lit:
            raise Refused(
                self._device,
                f"{sequence.exposure_us:g} us are shorter than a video frame",
                f"give at least {frame_us:.6g} us",
            )
        whole = max(lit, round((sequence.period_us or 0.0) / frame_us))
        self._order, self._frames = sequence.order, (lit, whole)
        with self._talking():
            self.dark()
        return PatternSequence(sequence.order, lit * frame_us, whole * frame_us, BITS)

    def show(self, index: int) -> None:
        """Show one pattern, and wait for the delay of the display."""
        with self._talking():
            self._call("show", index=index)
        self._pause(self._settings.display_delay_s)

    def show_position(self, position: int) -> None:
        """Show the pattern at one position of the order."""
        self.show(self._order[position])

    def run(self, *, repeat: bool) -> None:
        """Start the order; the window's process keeps the times."""
        lit, whole = (frames / self._settings.refresh_hz for frames in self._frames)
        with self._talking():
            self._call("run", order=self._order, exposure_s=lit, period_s=whole, repeat=repeat)

    def dark(self) -> None:
        """Show black."""
        self._call("dark")

    def running(self) -> bool:
        """Whether a sequence runs."""
        return bool(self._call("status")["running"])

    def _call(self, call: str, data: bytes = b"", *, timeout_s: float | None = None, **values: Any) -> dict[str, Any]:
        child = self._child
        if child is None:
            raise DeviceLost(self._device, "the window is closed", "open the projector again")
        try:
            return child.call(call, data, timeout_s=timeout_s or CALL_LIMIT_S, **values)
        except (DeviceLost, TimedOut):
            self.close()
            raise
