"""What the simulated LightCommander does, whatever it is told over: memory, display, LEDs, faults."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sims.clock import WorldClock
from sims.projector.bitplanes import COLUMNS, PLANE_BYTES, PLANES, ROWS, PlanePattern
from sims.projector.heat import COOL_ENOUGH_C, LedHeat
from sims.projector.lightcommander_frames import Status
from sims.projector.player import Image, Light, Player, Programme
from sims.projector.sequence_file import (
    LEDS,
    SEQ_LUT_REGISTER,
    Sequence,
    decode,
    shortest_period_us,
)

# The mirrors take this long to load before a pattern appears.
LOAD_S = 230e-6
DATA_SOURCES = ("DVI", "EXP", "TPG", "SL_AUTO", "SL_EXT3P3", "SL_EXT1P8", "SL_SW")
BY_ITSELF = ("SL_AUTO", "SL_SW")
ON_TRIGGER = ("SL_EXT3P3", "SL_EXT1P8")
EMPTY_PLANE = bytes(PLANE_BYTES)

VideoSource = Callable[[], Image | None]


class Refusal(Exception):
    """The box does not do what it was told."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


@dataclass(frozen=True, slots=True)
class _VideoPattern:
    """Whatever arrives at the video input at the time of looking."""

    video: VideoSource

    def image(self) -> Image:
        image = self.video()
        if image is None:
            return np.zeros((ROWS, COLUMNS), np.uint8)
        return image


@dataclass(slots=True)
class _Led:
    enabled: bool = False
    percent: float = 0.0


class LightCommanderBox:
    """The state of the box.

    Parameters
    ----------
    clock
        The clock of the world.
    outputs
        Number of sync outputs.
    video
        What arrives at the video input.
    """

    def __init__(self, clock: WorldClock, outputs: int, video: VideoSource | None) -> None:
        self._clock = clock
        self._lock = threading.RLock()
        self._video = video
        self.player = Player(clock, outputs)
        self.planes = [EMPTY_PLANE] * PLANES
        self.registers: dict[int, int] = {}
        self.sequence: Sequence | None = None
        self.parked = False
        self.too_hot = False
        self.lit: tuple[str, ...] = ()
        self.broken_led: str | None = None
        self._lut: list[int] | None = None
        self._order: tuple[int, tuple[int, ...]] | None = None
        self._leds = {led: _Led() for led in LEDS}
        self._driver_on = False
        self._source = "SL_AUTO"
        self._trigger_rising = True
        # Place in the order of a manual display; of a triggered pass with how often it goes round (None: for
        # ever).
        self._manual: int | None = None
        self._awaited: tuple[int, int | None] | None = None
        self._heat = LedHeat(clock, self.overheat)

    # --- memory and sequence

    def set_order(self, bits: int, images: tuple[int, ...]) -> None:
        """Set which images are shown, and of how many bits each is."""
        if not 1 <= bits <= 8 or not images or max(images) >= PLANES // bits:
            raise Refusal(Status.VALUE)
        with self._lock:
            self._order = bits, images
            self._end_display()

    def begin_lut(self) -> None:
        """Begin the words of a sequence."""
        self._lut = []

    def write_register(self, register: int, value: int) -> None:
        """Write a register; between begin and end, 0x1111 takes the words of a sequence."""
        if not 0 <= value < 1 << 32 or not 0 <= register < 1 << 32:
            raise Refusal(Status.VALUE)
        if register == SEQ_LUT_REGISTER and self._lut is not None:
            self._lut.append(value)
        else:
            self.registers[register] = value

    def end_lut(self) -> None:
        """Take the words of a sequence as the sequence to show."""
        words, self._lut = self._lut, None
        if words is None:
            raise Refusal(Status.NOT_NOW)
        sequence = decode(words)
        if sequence is None:
            raise Refusal(Status.VALUE)
        # Words are kept to 0.1 us: 700 Hz need not be hit more exactly than that.
        if sequence.period_us < shortest_period_us(sequence.bits) - 0.1:
            raise Refusal(Status.TOO_FAST)
        with self._lock:
            self.sequence = sequence
            self._end_display()
            self.update_light()

    # --- display

    @property
    def running(self) -> bool:
        """Whether patterns are shown or awaited."""
        if self._source == "DVI":
            return False
        return self._awaited is not None or self.player.running(self._clock.now())

    def force_first(self) -> None:
        """Show the first pattern and hold it."""
        with self._lock:
            patterns = self._ready()
            self._manual, self._awaited = 0, None
            self._hold(patterns[0])

    def step(self) -> None:
        """Show the next pattern, after the last the first, and hold it."""
        with self._lock:
            patterns = self._ready()
            if self._manual is None:
                raise Refusal(Status.NOT_NOW)
            self._manual = (self._manual + 1) % len(patterns)
            self._hold(patterns[self._manual])

    def run_once(self) -> None:
        """Show every pattern once."""
        self._run(1)

    def run_repeatedly(self) -> None:
        """Show all patterns again and again."""
        self._run(None)

    def stop(self) -> None:
        """Show nothing."""
        with self._lock:
            self._end_display()

    def park(self) -> None:
        """Park the mirrors: nothing is shown until they are unparked and told what to show."""
        with self._lock:
            self.parked = True
            self._end_display()

    def unpark(self) -> None:
        """Free the mirrors."""
        with self._lock:
            self.parked = False
            self._end_display()

    def set_source(self, source: str) -> None:
        """Choose where patterns come from; whatever was shown ends."""
        with self._lock:
            self._source = source
            self._end_display()
            self.update_light()

    def set_trigger_edge(self, *, rising: bool) -> None:
        """Choose which edge of the trigger input counts."""
        self._trigger_rising = rising

    def external_trigger(self, time_s: float, *, rising: bool) -> None:
        """Show the next pattern of a pass that waits for this edge."""
        with self._lock:
            if self._awaited is None or rising != self._trigger_rising:
                return
            patterns = self._ready()
            index, passes = self._awaited
            self.player.show(self._automatic(time_s + LOAD_S, (patterns[index],), 1))
            index += 1
            if index == len(patterns):
                index, passes = 0, None if passes is None else passes - 1
            self._awaited = None if passes == 0 else (index, passes)

    def _ready(self) -> tuple[PlanePattern, ...]:
        """Return the patterns of the order, if all is there to show them."""
        if (
            self.parked
            or self.sequence is None
            or self._order is None
            or self._source
            not in (
                *BY_ITSELF,
                *ON_TRIGGER,
            )
        ):
            raise Refusal(Status.NOT_NOW)
        bits, images = self._order
        if bits != self.sequence.bits:
            raise Refusal(Status.MISMATCH)
        return tuple(PlanePattern(tuple(self.planes[i * bits : (i + 1) * bits])) for i in images)

    def _hold(self, pattern: PlanePattern) -> None:
        start_s = self._clock.now() + LOAD_S
        self.player.show(Programme(start_s, (pattern,), rising=(True,)))

    def _run(self, passes: int | None) -> None:
        with self._lock:
            patterns = self._ready()
            self._end_display()
            if self._source in ON_TRIGGER:
                self._awaited = (0, passes)
            else:
                self.player.show(self._automatic(self._clock.now() + LOAD_S, patterns, passes))

    def _automatic(self, start_s: float, patterns: tuple[PlanePattern, ...], passes: int | None) -> Programme:
        assert self.sequence is not None
        period_s = self.sequence.period_us / 1e6
        return Programme(
            start_s,
            patterns,
            period_s,
            self.sequence.exposure_us / 1e6,
            len(patterns) * period_s,
            passes,
            (True,) * len(patterns),
        )

    def _end_display(self) -> None:
        self._manual = self._awaited = None
        shows_video = self._source == "DVI" and self._video is not None and not self.parked
        patterns = (_VideoPattern(self._video),) if shows_video and self._video else ()
        self.player.show(Programme(self._clock.now(), patterns))

    # --- light

    def enable_led(self, led: str, on: bool) -> None:
        """Enable or disable an LED."""
        self._leds[led].enabled = on
        self.update_light()

    def set_intensity(self, led: str, percent: float) -> None:
        """Set the intensity of an LED; the box believes that more than 60 % is good for it."""
        if not 0 <= percent <= 100:
            raise Refusal(Status.VALUE)
        self._leds[led].percent = percent
        self.update_light()

    def intensity_percent(self, led: str) -> float:
        """Return the intensity of an LED."""
        return self._leds[led].percent

    def enable_driver(self, on: bool) -> None:
        """Switch the LED driver; off and on again, once cooler, ends a shutdown by heat."""
        with self._lock:
            if on and self.too_hot:
                if self._driver_on or self._heat.temperature_c > COOL_ENOUGH_C:
                    raise Refusal(Status.TOO_HOT)
                self.too_hot = False
            self._driver_on = on
            self.update_light()

    def overheat(self) -> None:
        """Switch the LEDs off for heat."""
        with self._lock:
            self.too_hot = True
            self.update_light()

    def update_light(self) -> None:
        """Light what is to be lit now."""
        with self._lock:
            on = self._driver_on and not self.too_hot
            named = LEDS if self._source == "DVI" or self.sequence is None else self.sequence.leds
            self.lit = tuple(
                led
                for led in named
                if on and self._leds[led].enabled and self._leds[led].percent > 0 and led != self.broken_led
            )
            levels = {led: self._leds[led].percent / 100 for led in self.lit}
            self.player.light(Light(self._clock.now(), levels))
            self._heat.set_level(max(levels.values(), default=0.0))
