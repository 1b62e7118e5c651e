"""What a projector shows at any time, and when its sync edges fall.

A player keeps a history of programmes (patterns with their timing) and of the state of the light. What is
shown at a time is arithmetic on both, whoever asks and however late, so the camera's twin may ask for an
exposure that is over. Nothing here has a thread: the clock calls when an edge is due, and is late by what the
machine is late, but the time that the edge is given is exact.
"""

import math
import threading
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise, zip_longest
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sims.clock import Alarm, WorldClock

Image = NDArray[np.uint8]
DARK = "none"
# Changes that are remembered: at one a millisecond, the last eight seconds.
REMEMBERED = 8192
ROUNDING_S = 1e-9


class Pattern(Protocol):
    """Something that can be on the mirrors."""

    def image(self) -> Image:
        """Return it as grey values, 0 to 255 (the mean over a frame, where mirrors flicker)."""
        ...


class Shown(NamedTuple):
    """What a projector shows: an image (None: black), the LEDs that are lit, and their level from 0 to 1."""

    image: Image | None
    led: str
    level: float


NOTHING = Shown(None, DARK, 0.0)


@dataclass(frozen=True, slots=True)
class Programme:
    """Patterns with their timing, from `start_s` until the next programme.

    Pattern k of pass n comes at ``start_s + n pass_s + k period_s`` and stays for `exposure_s`. `passes` None
    repeats for ever; `rising` tells which patterns raise a sync edge; an infinite period holds the first
    pattern.
    """

    start_s: float
    patterns: tuple[Pattern, ...] = ()
    period_s: float = math.inf
    exposure_s: float = math.inf
    pass_s: float = math.inf
    passes: int | None = 1
    rising: tuple[bool, ...] = ()
    leds: tuple[frozenset[str], ...] = ()

    @property
    def end_s(self) -> float:
        """The end of the last pattern's period."""
        if self.passes is None or not self.patterns:
            return math.inf
        if math.isinf(self.period_s):
            return math.inf
        return self.start_s + (self.passes - 1) * self.pass_s + len(self.patterns) * self.period_s

    def at(self, time_s: float) -> tuple[int, float] | None:
        """Return (index of the pattern, seconds since it came), or None if there is none at that time."""
        # A nanosecond ahead, so that a pattern's own start, as computed, is never before it.
        since_s = time_s - self.start_s + ROUNDING_S
        if since_s < 0 or not self.patterns or time_s + ROUNDING_S >= self.end_s:
            return None
        if math.isinf(self.period_s):
            return 0, since_s
        passed = math.floor(since_s / self.pass_s)
        within_s = since_s - passed * self.pass_s
        index = math.floor(within_s / self.period_s)
        if index >= len(self.patterns):
            return None
        into_s = within_s - index * self.period_s
        return (index, into_s) if into_s < self.exposure_s else None

    def edges(self, after_s: float, until_s: float) -> Iterator[float]:
        """Yield the times of its sync edges in ``after_s < t <= until_s``."""
        if not any(self.rising) or until_s < self.start_s:
            return
        passed = 0
        if not math.isinf(self.pass_s) and after_s > self.start_s:
            passed = max(0, math.floor((after_s - self.start_s) / self.pass_s) - 1)
        while self.passes is None or passed < self.passes:
            base_s = self.start_s if passed == 0 else self.start_s + passed * self.pass_s
            if base_s > until_s:
                return
            for index, rises in enumerate(self.rising):
                time_s = base_s if index == 0 else base_s + index * self.period_s
                if time_s > until_s:
                    return
                if rises and time_s > after_s:
                    yield time_s
            passed += 1


@dataclass(frozen=True, slots=True)
class Light:
    """The levels, 0 to 1, of the LEDs that may be lit from a time on."""

    start_s: float
    levels: Mapping[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class SyncOutput:
    """One sync output: edges come `delay_s` after a pattern."""

    enabled: bool = False
    delay_s: float = 0.0
    width_s: float = 0.0
    rising: bool = True


def _start(change: Programme | Light) -> float:
    return change.start_s


class Player:
    """The history of one projector.

    Parameters
    ----------
    clock
        The clock of the world.
    outputs
        Number of sync outputs.
    """

    def __init__(self, clock: WorldClock, outputs: int) -> None:
        self._clock = clock
        self._lock = threading.RLock()
        self._programmes: list[Programme] = [Programme(-math.inf)]
        self._lights: list[Light] = [Light(-math.inf)]
        self._outputs = [SyncOutput() for _ in range(outputs)]
        self._listeners: list[list[Callable[[float], None]]] = [[] for _ in range(outputs)]
        self._told_s = [clock.now()] * outputs
        self._alarm: Alarm | None = None
        self._missed = 0

    def on_sync(self, callback: Callable[[float], None], output: int = 0) -> None:
        """Call `callback(time_s)` at every leading edge of a sync output, from the clock's thread."""
        with self._lock:
            self._listeners[output].append(callback)
            self._told_s[output] = self._clock.now()

    def miss_sync(self, edges: int = 1) -> None:
        """Swallow the next sync edges."""
        with self._lock:
            self._missed += edges

    def output(self, number: int) -> SyncOutput:
        """Return the settings of a sync output."""
        return self._outputs[number]

    def set_output(self, number: int, settings: SyncOutput) -> None:
        """Change a sync output: edges from now on follow it."""
        with self._lock:
            self._outputs[number] = settings
            self._told_s[number] = self._clock.now()
        self._set_alarm()

    def show(self, programme: Programme) -> None:
        """Let a programme follow the present one from its start on."""
        with self._lock:
            while len(self._programmes) > 1 and self._programmes[-1].start_s >= programme.start_s:
                self._programmes.pop()
            self._programmes.append(programme)
            del self._programmes[: max(0, len(self._programmes) - REMEMBERED)]
        self._set_alarm()

    def light(self, light: Light) -> None:
        """Change the light."""
        with self._lock:
            self._lights.append(light)
            del self._lights[: max(0, len(self._lights) - REMEMBERED)]

    @property
    def programme(self) -> Programme:
        """The programme that was set last (it may be about to start)."""
        return self._programmes[-1]

    def running(self, time_s: float) -> bool:
        """Whether a programme runs at a time."""
        programme = self.programme
        return bool(programme.patterns) and time_s < programme.end_s

    def _place(self, time_s: float) -> tuple[Programme, int | None]:
        with self._lock:
            programme = self._programmes[bisect_right(self._programmes, time_s, key=_start) - 1]
        place = programme.at(time_s)
        return programme, place[0] if place else None

    def index_at(self, time_s: float) -> int | None:
        """Return which pattern of its programme is on the mirrors at a time, lit or not."""
        return self._place(time_s)[1]

    def shown_at(self, time_s: float) -> Shown:
        """Return what is shown at a time; a running programme is dark between its exposures."""
        levels = self.lights_at(time_s)
        programme, index = self._place(time_s)
        if index is not None and programme.leds:
            levels = {led: level for led, level in levels.items() if led in programme.leds[index]}
        between = index is None and programme.patterns and time_s < programme.end_s
        if not levels or between:
            return NOTHING
        image = None if index is None else programme.patterns[index].image()
        return Shown(image, "+".join(levels), max(levels.values()))

    def lights_at(self, time_s: float) -> dict[str, float]:
        """Return the levels, above 0, of the LEDs that may be lit at a time, whatever is on the mirrors."""
        with self._lock:
            light = self._lights[bisect_right(self._lights, time_s, key=_start) - 1]
        return {led: level for led, level in light.levels.items() if level > 0}

    def lit_last(self, time_s: float) -> str | None:
        """Return the LEDs that are lit at a time, or were lit last before it, joined by "+"; None if none ever was."""
        with self._lock:
            known = self._lights[: bisect_right(self._lights, time_s, key=_start)]
        for light in reversed(known):
            lit = [led for led, level in light.levels.items() if level > 0]
            if lit:
                return "+".join(lit)
        return None

    def intervals(self, start_s: float, end_s: float) -> list[tuple[float, float, Shown]]:
        """Return what is shown from `start_s` to `end_s`, as (start, end, shown) without gaps.

        That is what a camera needs whose exposure does not lie within one pattern.
        """
        cuts = [start_s]
        for cut_s in sorted(self._changes(start_s, end_s)):
            # The end of one pattern and the start of the next may differ by a rounding.
            if cut_s - cuts[-1] > ROUNDING_S and end_s - cut_s > ROUNDING_S:
                cuts.append(cut_s)
        cuts.append(end_s)
        return [(from_s, to_s, self.shown_at((from_s + to_s) / 2)) for from_s, to_s in pairwise(cuts)]

    def _changes(self, start_s: float, end_s: float) -> Iterator[float]:
        with self._lock:
            first = bisect_right(self._programmes, start_s, key=_start) - 1
            lights, programmes = list(self._lights), self._programmes[max(first, 0) :]
        yield from (light.start_s for light in lights if start_s < light.start_s < end_s)
        for programme, following in zip_longest(programmes, programmes[1:]):
            until_s = min(end_s, following.start_s if following else math.inf)
            if start_s < programme.start_s < end_s:
                yield programme.start_s
            every = replace(programme, rising=(True,) * len(programme.patterns))
            longest_s = min(programme.exposure_s, programme.period_s)
            for came_s in every.edges(start_s - longest_s if math.isfinite(longest_s) else start_s, until_s):
                yield from (t for t in (came_s, came_s + longest_s) if start_s < t < until_s)

    # --- edges

    def _edges(self, number: int, after_s: float, until_s: float) -> Iterator[float]:
        """Yield the edges of an output in order; a programme's edges end where the next one starts."""
        delay_s = self._outputs[number].delay_s
        # Subtracting a delay that is added again may lose a rounding: look a little wider, then compare
        # exactly.
        first = bisect_right(self._programmes, after_s - delay_s - ROUNDING_S, key=_start) - 1
        programmes = self._programmes[max(first, 0) :]
        for programme, following in zip_longest(programmes, programmes[1:]):
            for time_s in programme.edges(after_s - delay_s - ROUNDING_S, until_s - delay_s + ROUNDING_S):
                if following is not None and time_s >= following.start_s:
                    break
                if after_s < time_s + delay_s <= until_s:
                    yield time_s + delay_s

    def _tell(self) -> None:
        """Tell the listeners of all edges up to now; called by the clock."""
        now_s = self._clock.now()
        due: list[tuple[float, Callable[[float], None]]] = []
        with self._lock:
            for number, output in enumerate(self._outputs):
                after_s, self._told_s[number] = self._told_s[number], max(now_s, self._told_s[number])
                if not output.enabled:
                    continue
                for time_s in self._edges(number, after_s, now_s):
                    if self._missed:
                        self._missed -= 1
                    else:
                        due.extend((time_s, listener) for listener in self._listeners[number])
        # Outside the lock: a listener may ask what is shown, from whatever thread.
        for time_s, listener in sorted(due, key=lambda entry: entry[0]):
            listener(time_s)
        self._set_alarm()

    def _set_alarm(self) -> None:
        with self._lock:
            upcoming = [
                time_s
                for number, output in enumerate(self._outputs)
                if output.enabled and self._listeners[number]
                for time_s in [next(self._edges(number, self._told_s[number], math.inf), None)]
                if time_s is not None
            ]
            if self._alarm is not None:
                self._alarm.cancel()
                self._alarm = None
            if upcoming:
                self._alarm = self._clock.call_at(min(upcoming), self._tell)

    def close(self) -> None:
        """Raise no further edges."""
        with self._lock:
            self._listeners = [[] for _ in self._outputs]
            if self._alarm is not None:
                self._alarm.cancel()


class Projection:
    """What a projector twin offers the world: what it shows, now or at any time that is not long over."""

    player: Player
    _clock: WorldClock

    def showing(self) -> Shown:
        """Return what is shown now."""
        return self.player.shown_at(self._clock.now())

    def shown_at(self, time_s: float) -> Shown:
        """Return what is shown at a time."""
        return self.player.shown_at(time_s)

    def intervals(self, start_s: float, end_s: float) -> list[tuple[float, float, Shown]]:
        """Return what is shown from `start_s` to `end_s`, as (start, end, shown) without gaps."""
        return self.player.intervals(start_s, end_s)

    def on_sync(self, callback: Callable[[float], None], output: int = 0) -> None:
        """Call `callback(time_s)` at every leading edge of a sync output, from the clock's thread."""
        self.player.on_sync(callback, output)

    def close(self) -> None:
        """Raise no further edges."""
        self.player.close()
