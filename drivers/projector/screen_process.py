"""The process that owns the window: `python -m drivers.projector.screen_process SOCKET OPTIONS`."""

import ctypes
import os
import select
import socket
import time
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.projector.messages import Failure, receive, run, send

# How often events are looked at while nothing else happens.
LOOK_ROUND_S = 0.02
# Drivers of SDL that show nothing to anyone.
INVISIBLE = (b"dummy", b"offscreen", b"evdev")
GREY = np.arange(256, dtype=np.uint32) * 0x010101


class Window:
    """A borderless window with one grey picture.

    Parameters
    ----------
    options
        The fields of `drivers.projector.screen.ScreenSettings`.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        if options["x_display"] is not None:
            os.environ |= {"DISPLAY": options["x_display"], "SDL_VIDEODRIVER": "x11"}
        try:
            # Imported here: SDL reads the environment when it is loaded.
            with warnings.catch_warnings(action="ignore"):
                import sdl2
        except ImportError as error:
            what = f"there is no SDL: {error}"
            raise Failure("ConfigurationError", what, "install PySDL2 and pysdl2-dll") from None
        self._sdl = sdl2
        if sdl2.SDL_Init(sdl2.SDL_INIT_VIDEO):
            raise Failure("NotConnected", f"no display: {self._error()}", "name one that runs, and its X server")
        if sdl2.SDL_GetCurrentVideoDriver() in INVISIBLE:
            raise Failure("NotConnected", "there is no display that anyone sees", "run it in a graphical session")
        self._size: tuple[int, int] = tuple(options["size_px"])
        self._window = self._place(int(options["display"]), options["corner_px"])
        sdl2.SDL_ShowCursor(sdl2.SDL_DISABLE)
        sdl2.SDL_DisableScreenSaver()
        self._event = sdl2.SDL_Event()
        self.draw(None)

    def _place(self, display: int, corner: list[int] | None) -> Any:
        sdl2, (width, height) = self._sdl, self._size
        count, room = sdl2.SDL_GetNumVideoDisplays(), sdl2.SDL_Rect()
        if display >= count or sdl2.SDL_GetDisplayBounds(display, room):
            raise Failure("NotConnected", f"there is no display {display}", f"give 0 to {count - 1}")
        left, top = corner or (0, 0)
        exact, fits = (room.w, room.h) == self._size, left + width <= room.w and top + height <= room.h
        if not (exact if corner is None else fits):
            raise Failure(
                "ConfigurationError",
                f"display {display} has {room.w} x {room.h} pixels, the patterns {width} x {height} at ({left}, {top})",
                "set the display's mode to the size of the projector, or `corner_px`",
            )
        flags = sdl2.SDL_WINDOW_BORDERLESS | sdl2.SDL_WINDOW_ALWAYS_ON_TOP | sdl2.SDL_WINDOW_SKIP_TASKBAR
        window = sdl2.SDL_CreateWindow(b"projector", room.x + left, room.y + top, width, height, flags)
        if not window:
            raise Failure("NotConnected", f"no window: {self._error()}", "look at the display's settings")
        if sdl2.SDL_GetWindowDisplayIndex(window) != display:
            what = f"display {display} cannot be told from another one"
            raise Failure("ConfigurationError", what, "let both displays belong to one X screen, side by side")
        return window

    def draw(self, image: NDArray[np.uint8] | None) -> None:
        """Show an image, or black."""
        sdl2, (width, height) = self._sdl, self._size
        # Asked for anew: it changes with the window.
        surface = sdl2.SDL_GetWindowSurface(self._window).contents
        if surface.format.contents.BitsPerPixel != 32 or (surface.w, surface.h) != self._size:
            what = "the window has another size, or other pixels, than it was given"
            raise Failure("DeviceFault", what, "set the display to 24 bits, and let no window manager resize it")
        words = ctypes.cast(surface.pixels, ctypes.POINTER(ctypes.c_uint32))
        pixels = np.ctypeslib.as_array(words, (height, surface.pitch // 4))[:, :width]
        if image is None:
            pixels[:] = 0
        else:
            pixels[:] = GREY[image]
        self._flip()

    def attend(self) -> None:
        """Answer the window system; draw again what was covered."""
        sdl2 = self._sdl
        while sdl2.SDL_PollEvent(self._event):
            if self._event.type == sdl2.SDL_WINDOWEVENT and self._event.window.event == sdl2.SDL_WINDOWEVENT_EXPOSED:
                self._flip()

    def _flip(self) -> None:
        if self._sdl.SDL_UpdateWindowSurface(self._window):
            raise Failure("DeviceFault", f"the window cannot be drawn: {self._error()}", "look at the display")

    def _error(self) -> str:
        return str(self._sdl.SDL_GetError().decode("utf-8", "replace"))


@dataclass(slots=True)
class Run:
    """A sequence that runs: its next change, and when that is."""

    order: list[int]
    exposure_s: float
    period_s: float
    repeat: bool
    next_s: float
    position: int = 0
    lit: bool = False


class Player:
    """Shows patterns, by hand or by the clock.

    Parameters
    ----------
    window
        Where.
    size
        (width, height) of a pattern.
    """

    def __init__(self, window: Window, size: tuple[int, int]) -> None:
        self._window = window
        self._shape = (size[1], size[0])
        self._patterns = np.empty((0, *self._shape), np.uint8)
        self._run: Run | None = None

    def obey(self, head: dict[str, Any], data: bytes) -> dict[str, Any]:
        """Carry out one call."""
        call = head["call"]
        if call == "status":
            return {"running": self._run is not None}
        self._run = None
        if call == "load":
            self._window.draw(None)
            self._patterns = np.frombuffer(data, np.uint8).reshape(head["count"], *self._shape)
        elif call == "show":
            self._window.draw(self._patterns[head["index"]])
        elif call == "dark":
            self._window.draw(None)
        elif call == "run":
            times = head["exposure_s"], head["period_s"]
            self._run = Run(head["order"], *times, repeat=head["repeat"], next_s=time.monotonic())
            self.tick()
        return {}

    def due_in_s(self) -> float:
        """Return how long nothing has to change."""
        return LOOK_ROUND_S if self._run is None else self._run.next_s - time.monotonic()

    def tick(self) -> None:
        """Make the change that is due, if one is."""
        run = self._run
        if run is None or time.monotonic() < run.next_s:
            return
        if run.lit and run.period_s > run.exposure_s:
            self._window.draw(None)
            run.lit, run.next_s = False, run.next_s + run.period_s - run.exposure_s
            return
        if run.position == len(run.order):
            if not run.repeat:
                self._window.draw(None)
                self._run = None
                return
            run.position = 0
        self._window.draw(self._patterns[run.order[run.position]])
        run.position += 1
        run.lit, run.next_s = True, run.next_s + run.exposure_s


def serve(connection: socket.socket, options: dict[str, Any]) -> None:
    """Open the window, then answer calls until the other end has gone."""
    try:
        window = Window(options)
    except Failure as failure:
        send(connection, failure.message)
        return
    player = Player(window, tuple(options["size_px"]))
    send(connection, {})
    while True:
        wait_s = min(LOOK_ROUND_S, max(0.0, player.due_in_s()))
        if select.select([connection], [], [], wait_s)[0]:
            head, data = receive(connection)
            try:
                answer = player.obey(head, data)
            except Failure as failure:
                answer = failure.message
            send(connection, answer)
        player.tick()
        window.attend()


if __name__ == "__main__":
    run(serve)
