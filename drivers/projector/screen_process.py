"""The process that owns the window: `python -m drivers.projector.screen_process SOCKET OPTIONS`."""

import json
import os
import select
import signal
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.projector.messages import receive, send

os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"

# How often events are looked at while nothing else happens.
LOOK_ROUND_S = 0.02
# SDL's number of a display goes into a window's place like this (SDL_WINDOWPOS_CENTERED_DISPLAY).
CENTRED_ON_DISPLAY = 0x2FFF0000
# Drivers of SDL that show nothing to anyone.
INVISIBLE = ("dummy", "offscreen", "evdev")
GREY = np.arange(256, dtype=np.uint32) * 0x010101


class ScreenError(Exception):
    """What went wrong, as (name of the error, what, remedy)."""


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
        # Imported here: SDL reads the environment when it is loaded.
        import pygame

        self._pygame = pygame
        try:
            pygame.display.init()
        except pygame.error as error:
            raise ScreenError("NotConnected", f"no display: {error}", "name one that runs, and its X server") from None
        if pygame.display.get_driver() in INVISIBLE:
            raise ScreenError("NotConnected", "there is no display that anyone sees", "run it in a graphical session")
        self._size: tuple[int, int] = tuple(options["size_px"])
        self._window = self._place(int(options["display"]), options["corner_px"])
        pygame.mouse.set_visible(False)
        pygame.display.set_allow_screensaver(False)
        self._surface = self._window.get_surface()
        if self._surface.get_bitsize() != 32 or self._surface.get_masks()[:3] != (0xFF0000, 0xFF00, 0xFF):
            raise ScreenError("ConfigurationError", "the display has no 8 bits a colour", "set its depth to 24 bits")
        self.draw(None)

    def _place(self, display: int, corner: list[int] | None) -> Any:
        pygame, size = self._pygame, self._size
        sizes = pygame.display.get_desktop_sizes()
        if display >= len(sizes):
            raise ScreenError("NotConnected", f"there is no display {display}", f"give 0 to {len(sizes) - 1}")
        room, at = sizes[display], corner or [0, 0]
        if (room != size) if corner is None else (at[0] + size[0] > room[0] or at[1] + size[1] > room[1]):
            raise ScreenError(
                "ConfigurationError",
                f"display {display} has {room[0]} x {room[1]} pixels, the patterns {size[0]} x {size[1]} at {at}",
                "set the display's mode to the size of the projector, or `corner_px`",
            )
        where: Any = CENTRED_ON_DISPLAY | display
        window = pygame.Window("projector", size, where, borderless=True, always_on_top=True)
        # It stands in the middle of its display: from there to the display's corner, and on to the place asked for.
        left, top = window.position
        window.position = (left - (room[0] - size[0]) // 2 + at[0], top - (room[1] - size[1]) // 2 + at[1])
        return window

    def draw(self, image: NDArray[np.uint8] | None) -> None:
        """Show an image, or black."""
        width, height = self._size
        if image is None:
            self._surface.fill(0)
        else:
            pixels = np.frombuffer(self._surface.get_buffer(), np.uint32).reshape(height, -1)
            np.take(GREY, image, out=pixels[:, :width])
            del pixels
        self._window.flip()

    def attend(self) -> None:
        """Answer the window system; draw again what was covered."""
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type in (pygame.WINDOWEXPOSED, pygame.WINDOWSHOWN, pygame.WINDOWRESTORED):
                self._window.flip()


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
    except ScreenError as error:
        kind, what, remedy = error.args
        send(connection, {"error": kind, "what": what, "remedy": remedy})
        return
    player = Player(window, tuple(options["size_px"]))
    send(connection, {})
    while True:
        wait_s = min(LOOK_ROUND_S, max(0.0, player.due_in_s()))
        if select.select([connection], [], [], wait_s)[0]:
            send(connection, player.obey(*receive(connection)))
        player.tick()
        window.attend()


def main() -> None:
    """Serve on the socket whose number is the first argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with socket.socket(fileno=int(sys.argv[1])) as connection:
        try:
            serve(connection, json.loads(sys.argv[2]))
        except OSError:
            return


if __name__ == "__main__":
    main()
