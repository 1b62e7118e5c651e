"""What the projector is told to show: which patterns lie in it, and by which of its times they are shown."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import Led, PatternTiming, Projector, ProjectorCapabilities
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.core import fringe_images

Orientation = Literal["x", "y"]
Fringes = tuple[tuple[float, ...], int, Orientation]

BITS = 8
WHITE, BLACK = 0, 1
_PLAIN = 2
# From the edge of the sync pulse to the exposure of the camera (10 us of an xiQ), and jitter.
TRIGGER_MARGIN_US = 50.0
# The clocks of camera and projector may differ: a trigger at the very period would now and then be missed.
PERIOD_MARGIN = 1.001
# Between two exposures a camera needs a moment (64.5 us of an xiQ): the longest one leaves it.
BETWEEN_US = 100.0


class PatternDeck:
    """White, black and fringe sets in the projector; loaded once, and again only if something is added or lost.

    Parameters
    ----------
    projector
        An opened projector.
    levels
        256 levels to show fringes by, each in the place of its index; None: as they are.

    Raises
    ------
    AcquisitionError
        It takes no patterns.
    """

    def __init__(self, projector: Projector, levels: bytes | None = None) -> None:
        self._projector = projector
        capabilities = projector.capabilities()
        if not capabilities.can_load:
            raise AcquisitionError(
                f"patterns cannot be loaded into {projector.name} ({capabilities.model}): they lie in its flash",
                "drive it by its video input",
            )
        self._size_px = capabilities.size_px
        self._limit = capabilities.pattern_limit
        self._levels = None if levels is None else np.frombuffer(levels, np.uint8)
        self._groups: dict[Fringes, int] = {}
        self._loaded = False

    def forget(self) -> None:
        """Load again before the next use: the projector may have lost what it had."""
        self._loaded = False

    def plain(self, index: int) -> tuple[int, ...]:
        """Order that shows white or black (`WHITE`, `BLACK`); loads what is not there yet."""
        self._load()
        return (index,)

    def fringes(self, counts: tuple[float, ...], steps: int, orientation: Orientation) -> tuple[int, ...]:
        """Order that shows fringe sets, step by step; loads what is not there yet.

        Raises
        ------
        AcquisitionError
            More patterns than the projector holds.
        CountsError, FramesError
            Counts or steps of which no fringes can be made.
        """
        group = (counts, steps, orientation)
        size = len(counts) * steps
        if group not in self._groups:
            if self._limit is not None and size + _PLAIN > self._limit:
                raise AcquisitionError(
                    f"{size} fringe patterns, white and black are more than the {self._limit} that "
                    f"{self._projector.name} holds",
                    "take fewer sets or steps",
                )
            if self._limit is not None and sum(self._groups.values()) + size + _PLAIN > self._limit:
                self._groups.clear()
            self._groups[group] = size
            self._loaded = False
        try:
            self._load()
        except ValueError:
            del self._groups[group]
            raise
        first = _PLAIN
        for known, number in self._groups.items():
            if known == group:
                break
            first += number
        return tuple(range(first, first + size))

    def _load(self) -> None:
        if self._loaded:
            return
        width, height = self._size_px
        images: list[NDArray[np.uint8]] = [
            np.full((1, height, width), 255, np.uint8),
            np.zeros((1, height, width), np.uint8),
        ]
        for counts, steps, orientation in self._groups:
            made = fringe_images(counts, steps, self._size_px, axis=orientation)
            made = made if self._levels is None else self._levels[made]
            images.append(made.reshape(-1, height, width))
        self._projector.load(np.concatenate(images))
        self._loaded = True


def longest_exposure_us(capabilities: ProjectorCapabilities, led: Led) -> float:
    """Longest exposure of the camera that lies within one pattern of a self-paced projector."""
    usable = _usable(capabilities, led)
    if usable is None:
        return float("inf")
    longest_us = [
        min(timing.exposure_us - TRIGGER_MARGIN_US, timing.period_us / PERIOD_MARGIN - BETWEEN_US) for timing in usable
    ]
    return max(longest_us, default=0.0)


def choose_timing(
    capabilities: ProjectorCapabilities, led: Led, exposure_us: float, camera_period_us: float
) -> PatternTiming:
    """Shortest period of the projector that the camera can follow, with room for the camera's exposure.

    The mirrors show several bits plane by plane. That an exposure which ends before the pattern's sees all of them in
    proportion holds for the simulated box and is to be checked on a real one: see the driver's unverified facts.

    Parameters
    ----------
    capabilities
        What the projector can do.
    led
        The light in use.
    exposure_us
        Exposure of the camera; it begins with the pattern.
    camera_period_us
        Shortest time between two triggers of the camera at this exposure.

    Raises
    ------
    AcquisitionError
        No sequence of this projector is long enough.
    """
    lit_us, period_us = exposure_us + TRIGGER_MARGIN_US, camera_period_us * PERIOD_MARGIN
    usable = _usable(capabilities, led)
    if usable is None:
        return PatternTiming(lit_us, max(lit_us, period_us), BITS, (led,))
    fitting = [timing for timing in usable if timing.exposure_us >= lit_us and timing.period_us >= period_us]
    if not fitting:
        longest = max((timing.exposure_us for timing in usable), default=0.0)
        raise AcquisitionError(
            f"no sequence of the projector shows {BITS} bits in {led} for {lit_us:g} us every {period_us:g} us: "
            f"its longest exposure is {longest:g} us",
            "expose for a shorter time, or compile a longer sequence and name it in `sequences`",
        )
    return min(fitting, key=lambda timing: (timing.period_us, timing.exposure_us))


def held_timing(capabilities: ProjectorCapabilities, led: Led, exposure_us: float) -> PatternTiming:
    """Times to order patterns by that are shown by hand, each until the next: the nearest to the exposure.

    Raises
    ------
    AcquisitionError
        The projector has no sequence of 8 bits in this light.
    """
    usable = _usable(capabilities, led)
    if usable is None:
        return PatternTiming(exposure_us, exposure_us, BITS, (led,))
    if not usable:
        return choose_timing(capabilities, led, exposure_us, exposure_us)
    return min(usable, key=lambda timing: abs(timing.exposure_us - exposure_us))


def _usable(capabilities: ProjectorCapabilities, led: Led) -> list[PatternTiming] | None:
    if capabilities.timings is None:
        return None
    return [timing for timing in capabilities.timings if timing.bits == BITS and led in timing.leds]
