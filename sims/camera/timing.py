"""When an xiQ camera exposes and reads out: pure arithmetic on moments of a clock."""

import math
from dataclasses import dataclass

TOLERANCE_S = 1e-9
"""Rounding that must not turn a trigger at the shortest period into a missed one."""


@dataclass(frozen=True, slots=True)
class SensorTiming:
    """Times of an MQ042RG-CM (xiQ technical manual 1.0: instruments notes, section 1).

    Reading out `n` lines takes `(constant_us + line_us n) bandwidth_factor`: 11 072.5 us for 2048 lines,
    hence 90.3 frames a second. An exposure begins `trigger_to_exposure_us` after its trigger. That the constant
    part also keeps two exposures apart is inferred, not documented.
    """

    constant_us: float = 64.5
    line_us: float = 5.375
    bandwidth_factor: float = 1.0
    trigger_to_exposure_us: float = 10.0

    def readout_s(self, lines: int) -> float:
        """Time to read `lines` lines out, in s."""
        return (self.constant_us + self.line_us * lines) * self.bandwidth_factor * 1e-6

    def shortest_period_s(self, exposure_s: float, lines: int) -> float:
        """Shortest time from one exposure's start to the next one's, in s."""
        return max(self.readout_s(lines), exposure_s + self.constant_us * 1e-6)


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame's moments, in seconds of the clock."""

    start_s: float
    exposure_s: float
    delivered_s: float


class Schedule:
    """What the sensor has been busy with, hence when it can expose next.

    An exposure may overlap the readout of the frame before, but its own readout begins after that one's end.

    Parameters
    ----------
    timing : SensorTiming
        The sensor's times.
    """

    def __init__(self, timing: SensorTiming):
        self._timing = timing
        self._last_start_s = -math.inf
        self._exposure_end_s = -math.inf
        self._readout_end_s = -math.inf

    def ready_s(self, exposure_s: float) -> float:
        """Earliest start of another exposure of `exposure_s` seconds; minus infinity before the first."""
        return max(self._exposure_end_s + self._timing.constant_us * 1e-6, self._readout_end_s - exposure_s)

    def expose(self, start_s: float, exposure_s: float, lines: int) -> Exposure:
        """Take an exposure into the books."""
        self._last_start_s = start_s
        self._exposure_end_s = start_s + exposure_s
        self._readout_end_s = self._exposure_end_s + self._timing.readout_s(lines)
        return Exposure(start_s, exposure_s, self._readout_end_s)

    def trigger(self, time_s: float, exposure_s: float, lines: int) -> Exposure | None:
        """Exposure that a trigger at `time_s` starts; None where the sensor is not ready and misses it."""
        start_s = time_s + self._timing.trigger_to_exposure_us * 1e-6
        if start_s + TOLERANCE_S < self.ready_s(exposure_s):
            return None
        return self.expose(start_s, exposure_s, lines)

    def free_running(self, now_s: float, exposure_s: float, lines: int, interval_s: float) -> Exposure:
        """Expose without a trigger, `interval_s` or what the sensor needs after the last start.

        Where the caller is late by more than a period, the missing frames were never exposed: the sensor of a
        simulation that is too slow runs slower, too.
        """
        start_s = max(self.ready_s(exposure_s), self._last_start_s + interval_s)
        period_s = max(interval_s, self._timing.shortest_period_s(exposure_s, lines))
        if start_s < now_s - period_s:
            start_s = now_s
        return self.expose(start_s, exposure_s, lines)
