"""A controller that speaks the binary dialect GCD040101M: it obeys and never answers.

Public is one third party's program, no document and no reply: frames of 10 bytes `00 00 40 ID CMD 00 b6 b7 b8
b9` at 9600 baud 8N1; direction is command 44 with `00 01 00 00 00` after it, speed 53 with `00 05 00 00 00`,
pulses 50 with `00 00 14 00 00`, go 47 with zeros. The byte order of the value b6..b9 is unknown for the
pulses (little endian is favoured by direction and speed), so it is a setting here. Everything else is an
assumption of the simulation, as strict as it can be: bytes that do not begin a frame are skipped, frames of
another shape are ignored, so is one that follows the last too quickly, and a frame that stops in the middle
is forgotten.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from sims.clock import WorldClock
from sims.stage.line import LineSettings
from sims.stage.motion import Axis

HEADER = bytes((0x00, 0x00, 0x40))
FRAME_BYTES = 10
DIRECTION, SPEED, PULSES, GO = 0x44, 0x53, 0x50, 0x47

ByteOrder = Literal["little", "big"]


@dataclass(slots=True)
class _Registers:
    direction: int = 0
    pulses: int | None = None


class Gcd040101m:
    """The firmware: bytes in, motion out.

    Parameters
    ----------
    axes
        The axes by their ID byte.
    clock
        The clock of the world.
    pulse_byte_order, setting_byte_order
        Byte order of the value of a pulse frame, and of direction and speed frames.
    positive_direction
        Which direction code, 0 or 1, moves towards positive counts.
    speed_unit_mm_s
        Speed of one unit of the speed value (unknown; the default makes 5 20 mm/s).
    shortest_gap_s
        A frame is lost if it ends sooner than this after the one before (that program waits 0.1 s).
    forgets_after_s
        A frame that stops in the middle is forgotten after this.
    """

    line = LineSettings(baud=9600)

    def __init__(
        self,
        axes: Mapping[int, Axis],
        clock: WorldClock,
        *,
        pulse_byte_order: ByteOrder = "little",
        setting_byte_order: ByteOrder = "little",
        positive_direction: int = 1,
        speed_unit_mm_s: float = 4.0,
        shortest_gap_s: float = 0.05,
        forgets_after_s: float = 0.5,
    ) -> None:
        self._axes = dict(axes)
        self._clock = clock
        self._orders: dict[int, ByteOrder] = {
            DIRECTION: setting_byte_order,
            SPEED: setting_byte_order,
            PULSES: pulse_byte_order,
            GO: setting_byte_order,
        }
        self._positive_direction = positive_direction
        self._speed_unit_mm_s = speed_unit_mm_s
        self._shortest_gap_s = shortest_gap_s
        self._forgets_after_s = forgets_after_s
        self._registers = {address: _Registers() for address in self._axes}
        self._pending = b""
        self._last_byte_s = self._last_frame_s = float("-inf")

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line; the reply is always empty."""
        now_s = self._clock.now()
        if now_s - self._last_byte_s > self._forgets_after_s:
            self._pending = b""
        self._last_byte_s = now_s
        self._pending += data
        while True:
            self._skip_to_header()
            if len(self._pending) < FRAME_BYTES:
                return b""
            frame, self._pending = self._pending[:FRAME_BYTES], self._pending[FRAME_BYTES:]
            in_time = now_s - self._last_frame_s >= self._shortest_gap_s
            self._last_frame_s = now_s
            if in_time and frame[5] == 0:
                self._obey(frame[3], frame[4], frame[6:])

    def _skip_to_header(self) -> None:
        while self._pending and not self._pending.startswith(HEADER[: len(self._pending)]):
            self._pending = self._pending[1:]

    def _obey(self, address: int, command: int, field: bytes) -> None:
        axis, registers = self._axes.get(address), self._registers.get(address)
        order = self._orders.get(command)
        if axis is None or registers is None or order is None:
            return
        value = int.from_bytes(field, order)
        if command == DIRECTION and value in (0, 1):
            registers.direction = value
        elif command == SPEED and value:
            axis.speed = replace(axis.speed, full_mm_s=value * self._speed_unit_mm_s)
        elif command == PULSES:
            registers.pulses = value
        elif command == GO and value == 0 and registers.pulses is not None:
            pulses, registers.pulses = registers.pulses, None
            if not axis.busy:
                sign = 1 if registers.direction == self._positive_direction else -1
                settings = axis.settings
                by_mm = sign * settings.direction * pulses / settings.counts_per_mm
                axis.move_to(axis.controller_mm + by_mm)
