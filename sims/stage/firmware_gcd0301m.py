"""A controller that speaks the ASCII dialect GCD-0301M: it obeys and never answers.

What is public of this dialect is four frames seen in a third party's program, no document and no reply:
direction `@1D01`, speed `@1SEF`, pulses `@1P000000FF`, go `@0G`, each ended by CR LF, at 19200 baud 8N1.
Everything else here is an assumption of the simulation, as strict as it can be: any frame that is not exactly
one of these is ignored, and so is one that follows the last too quickly (that program waits 0.5 s; what the
box needs is unknown).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from sims.clock import WorldClock
from sims.stage.line import LineSettings
from sims.stage.motion import Axis

DIRECTION = re.compile(rb"@([1-9])D(00|01)")
SPEED = re.compile(rb"@([1-9])S([0-9A-F]{2})")
PULSES = re.compile(rb"@([1-9])P([0-9A-F]{8})")
GO = b"@0G"
LONGEST_FRAME = 16


@dataclass(slots=True)
class _Registers:
    direction: int = 0
    pulses: int = 0
    armed: bool = False


class Gcd0301m:
    """The firmware: bytes in, motion out.

    Parameters
    ----------
    axes
        The axes by the digit that addresses them.
    clock
        The clock of the world.
    positive_direction
        Which direction code, 0 or 1, moves towards positive counts.
    speed_unit_mm_s
        Speed of one unit of the speed code (unknown; the default makes EF 20 mm/s).
    shortest_gap_s
        A frame is lost if it ends sooner than this after the one before.
    """

    line = LineSettings(baud=19200)

    def __init__(
        self,
        axes: Mapping[int, Axis],
        clock: WorldClock,
        *,
        positive_direction: int = 1,
        speed_unit_mm_s: float = 20.0 / 0xEF,
        shortest_gap_s: float = 0.1,
    ) -> None:
        self._axes = dict(axes)
        self._clock = clock
        self._positive_direction = positive_direction
        self._speed_unit_mm_s = speed_unit_mm_s
        self._shortest_gap_s = shortest_gap_s
        self._registers = {address: _Registers() for address in self._axes}
        self._pending = b""
        self._last_frame_s = float("-inf")

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line; the reply is always empty."""
        *frames, self._pending = (self._pending + data).split(b"\r\n")
        if len(self._pending) > LONGEST_FRAME:
            self._pending = self._pending[-LONGEST_FRAME:]
        for frame in frames:
            now_s = self._clock.now()
            in_time = now_s - self._last_frame_s >= self._shortest_gap_s
            self._last_frame_s = now_s
            if in_time:
                self._obey(frame)
        return b""

    def _obey(self, frame: bytes) -> None:
        if frame == GO:
            self._go()
        elif (match := DIRECTION.fullmatch(frame)) and (registers := self._registers.get(int(match[1]))):
            registers.direction = int(match[2])
        elif (match := SPEED.fullmatch(frame)) and (axis := self._axes.get(int(match[1]))):
            if code := int(match[2], 16):
                axis.speed = replace(axis.speed, full_mm_s=code * self._speed_unit_mm_s)
        elif (match := PULSES.fullmatch(frame)) and (registers := self._registers.get(int(match[1]))):
            registers.pulses, registers.armed = int(match[2], 16), True

    def _go(self) -> None:
        """Start every axis that was given pulses since the last go; a moving one does not take them."""
        for address, registers in self._registers.items():
            axis = self._axes[address]
            if registers.armed and not axis.busy:
                sign = 1 if registers.direction == self._positive_direction else -1
                settings = axis.settings
                by_mm = sign * settings.direction * registers.pulses / settings.counts_per_mm
                axis.move_to(axis.controller_mm + by_mm)
            registers.armed = False
