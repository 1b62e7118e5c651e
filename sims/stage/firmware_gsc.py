"""A controller that speaks OptoSigma's GSC dialect (GSC-01): it answers, and its position can be read.

Documented: commands end with CR LF; `H:1` goes to the mechanical origin, `M:1+P1000` and `A:1-P500` prepare a
relative and an absolute move, `G:` starts what was prepared, `L:1` decelerates and stops, `L:E` stops at
once, `R:1` makes here the logical zero, `D:1S500F5000R200` sets start speed, full speed (pulses a second) and
acceleration time (ms). The answer is OK or NG. `Q:` answers `position,X|K,L|K,B|R` (last command refused or
accepted; stopped by a limit switch or not; busy or ready), the position signed and right-aligned in ten
characters; `!:` answers B or R.

While an axis is busy only L, Q and ! are accepted; G without anything prepared is NG; H, L and R forget what
was prepared. With two or more axes on one controller the axis is the digit of the command, or W for all of
them (`M:W` and `A:W` with one value an axis, as in `M:W+P100-P50`), and `Q:` lists all positions before the
letters, the second of which is then L for the first axis, M for the second and W for both, as the two-axis
controllers of that maker do.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from sims.clock import WorldClock
from sims.stage.line import LineSettings
from sims.stage.motion import Axis, Speed

LONGEST_LINE = 64
HIGHEST_COUNT = 16_777_215
SPEEDS_PPS = range(100, 20_001)
ACCELERATION_TIMES_MS = range(1001)
HOMING_PPS = (500, 5000, 200)
MOVE = re.compile(r"([MA]):([1-9]|W)((?:[+-]P[0-9]{1,8})+)")
VALUE = re.compile(r"([+-])P([0-9]{1,8})")
SPEED = re.compile(r"D:([1-9])S([0-9]{1,5})F([0-9]{1,5})R([0-9]{1,4})")
SIMPLE = re.compile(r"([HLR]):([1-9WE])")


@dataclass(slots=True)
class _State:
    zero_mm: float
    prepared_mm: float | None = None
    homing: bool = False


class Gsc:
    """The firmware: commands in, answers out.

    Parameters
    ----------
    axes
        The axes by the digit that addresses them, 1 first.
    clock
        The clock of the world.
    """

    line = LineSettings(baud=9600)

    def __init__(self, axes: Mapping[int, Axis], clock: WorldClock) -> None:
        self._axes = dict(sorted(axes.items()))
        self._clock = clock
        self._states = {address: _State(axis.controller_mm) for address, axis in self._axes.items()}
        self._refused = False
        self._pending = b""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and return the answers to the commands that they complete."""
        *lines, self._pending = (self._pending + data).split(b"\r\n")
        if len(self._pending) > LONGEST_LINE:
            self._pending = b""
        return b"".join(self._answer(line) for line in lines if line)

    def counts(self, address: int) -> int:
        """Return the counter of an axis as the controller shows it."""
        axis, state = self._axes[address], self._states[address]
        per_mm = axis.settings.counts_per_mm * axis.settings.direction
        return round((axis.controller_mm - state.zero_mm) * per_mm)

    def _answer(self, line: bytes) -> bytes:
        self._finish_homing()
        text = line.decode("ascii", errors="replace")
        if text == "!:":
            return b"B\r\n" if self._busy() else b"R\r\n"
        if text == "Q:":
            return self._status().encode("ascii")
        self._refused = not self._obey(text)
        return b"NG\r\n" if self._refused else b"OK\r\n"

    def _busy(self) -> bool:
        return any(axis.busy for axis in self._axes.values())

    def _status(self) -> str:
        positions = []
        for address in self._axes:
            counts = self.counts(address)
            positions.append(("-" if counts < 0 else " ") + f"{abs(counts):>9}")
        limited = [address for address, axis in self._axes.items() if axis.outcome == "limit" and not axis.busy]
        second = "K" if not limited else "W" if len(limited) > 1 else "LM"[min(limited[0], 2) - 1]
        letters = ("X" if self._refused else "K", second, "B" if self._busy() else "R")
        return ",".join((*positions, *letters)) + "\r\n"

    def _finish_homing(self) -> None:
        for address, axis in self._axes.items():
            state = self._states[address]
            if state.homing and not axis.busy:
                state.homing = False
                if axis.outcome == "done":
                    state.zero_mm = axis.controller_mm

    def _obey(self, text: str) -> bool:
        if match := SIMPLE.fullmatch(text):
            return self._simple(match[1], match[2])
        if self._busy():
            return False
        if text == "G:":
            return self._go()
        if match := MOVE.fullmatch(text):
            return self._prepare(match[1] == "A", match[2], match[3])
        if match := SPEED.fullmatch(text):
            return self._set_speed(int(match[1]), *(int(match[i]) for i in (2, 3, 4)))
        return False

    def _addressed(self, letter: str) -> list[int]:
        if letter in "WE":
            return list(self._axes)
        return [int(letter)] if int(letter) in self._axes else []

    def _simple(self, command: str, letter: str) -> bool:
        addresses = self._addressed(letter)
        if not addresses or (letter == "E" and command != "L"):
            return False
        if command != "L" and self._busy():
            return False
        for address in addresses:
            axis, state = self._axes[address], self._states[address]
            state.prepared_mm = None
            if command == "L":
                state.homing = False
                axis.stop(at_once=letter == "E")
            elif command == "R":
                state.zero_mm = axis.controller_mm
            else:
                axis.home(_speed(axis, *HOMING_PPS))
                state.homing = True
        return True

    def _prepare(self, absolute: bool, letter: str, values: str) -> bool:
        addresses = self._addressed(letter)
        counts = [int(digits) * (1 if sign == "+" else -1) for sign, digits in VALUE.findall(values)]
        if not addresses or len(counts) != len(addresses):
            return False
        targets = [
            count if absolute else self.counts(address) + count
            for address, count in zip(addresses, counts, strict=True)
        ]
        if any(abs(target) > HIGHEST_COUNT for target in targets):
            return False
        for address, target in zip(addresses, targets, strict=True):
            settings = self._axes[address].settings
            per_mm = settings.counts_per_mm * settings.direction
            self._states[address].prepared_mm = self._states[address].zero_mm + target / per_mm
        return True

    def _go(self) -> bool:
        prepared = {a: s.prepared_mm for a, s in self._states.items() if s.prepared_mm is not None}
        for address, target_mm in prepared.items():
            self._states[address].prepared_mm = None
            self._axes[address].move_to(target_mm)
        return bool(prepared)

    def _set_speed(self, address: int, start_pps: int, full_pps: int, time_ms: int) -> bool:
        if address not in self._axes or start_pps not in SPEEDS_PPS or full_pps not in SPEEDS_PPS:
            return False
        if full_pps < start_pps or time_ms not in ACCELERATION_TIMES_MS:
            return False
        axis = self._axes[address]
        axis.speed = _speed(axis, start_pps, full_pps, time_ms)
        return True


def _speed(axis: Axis, start_pps: int, full_pps: int, time_ms: int) -> Speed:
    """Return the speeds of an axis; they come in steps of 100 pulses a second, the rest is dropped."""
    start_mm_s, full_mm_s = (pps // 100 * 100 / axis.settings.counts_per_mm for pps in (start_pps, full_pps))
    # Equal speeds, or no time, are a jump to the full speed: a millisecond stands for it.
    acceleration_mm_s2 = max(full_mm_s - start_mm_s, full_mm_s / 1000) / max(time_ms / 1000, 0.001)
    return Speed(full_mm_s, acceleration_mm_s2, start_mm_s)
