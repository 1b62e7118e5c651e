"""How hot an LED driver gets: it warms towards a temperature that its level sets."""

import math
from collections.abc import Callable

from sims.clock import Alarm, WorldClock

AMBIENT_C, RISE_AT_FULL_C = 25.0, 80.0
# Reached at a level of 61 %: 60 % can be kept up for ever, more cannot.
LIMIT_C = AMBIENT_C + 0.61 * RISE_AT_FULL_C
COOL_ENOUGH_C = LIMIT_C - 5.0


class LedHeat:
    """The driver's temperature, and a call when it reaches the limit.

    Parameters
    ----------
    clock
        The clock of the world.
    too_hot
        Called by the clock when the limit is reached.
    time_constant_s
        Time in which the difference to the final temperature falls to 1/e.
    """

    def __init__(self, clock: WorldClock, too_hot: Callable[[], None], *, time_constant_s: float = 5.0) -> None:
        self._clock = clock
        self._too_hot = too_hot
        self._time_constant_s = time_constant_s
        self._since_s = clock.now()
        self._from_c = self._towards_c = AMBIENT_C
        self._alarm: Alarm | None = None

    @property
    def temperature_c(self) -> float:
        """The temperature now."""
        share = math.exp(-(self._clock.now() - self._since_s) / self._time_constant_s)
        return self._towards_c + (self._from_c - self._towards_c) * share

    def set_level(self, level: float) -> None:
        """Take note of the level, 0 to 1, from now on."""
        towards_c = AMBIENT_C + RISE_AT_FULL_C * level
        if towards_c == self._towards_c:
            return
        self._from_c, self._since_s = self.temperature_c, self._clock.now()
        self._towards_c = towards_c
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if towards_c > LIMIT_C:
            left = (towards_c - min(self._from_c, LIMIT_C)) / (towards_c - LIMIT_C)
            self._alarm = self._clock.call_at(self._since_s + self._time_constant_s * math.log(left), self._too_hot)
