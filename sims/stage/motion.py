"""How a stage moves: speed, limits, backlash, noise, ringing and lost steps, as functions of time.

Two positions are kept apart. The *controller's* is what its step counter implies; the *true* one is where the
carriage is, with everything that the counter does not know: backlash, lost steps, 1 um of noise a move, and
ringing after a stop. Nothing here has a thread: a position is computed for the time at which it is asked.
"""

import math
import threading
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sims.clock import WorldClock

# The carriage counts as settled when its ringing has decayed to this amplitude: from there on it stands still, so
# that who asks where it is gets one answer.
SETTLED_MM = 0.0005
# Changes of motion that are remembered.
REMEMBERED = 64

Outcome = Literal["done", "limit", "stalled", "stopped"]


@dataclass(frozen=True, slots=True)
class AxisSettings:
    """What one simulated axis is like.

    `travel_mm` are the positions of the two limit switches. Positive counts move towards higher mm if
    `direction` is 1, towards lower if it is -1. `ringing_um` is the amplitude after a stop from 20 mm/s; it
    decays to 0.5 um within `settle_s`. `noise_um` is the rms error that every move draws. `home_mm` is where
    the origin sensor sits.
    """

    counts_per_mm: float = 1000.0
    travel_mm: tuple[float, float] = (0.0, 300.0)
    start_mm: float = 0.0
    home_mm: float = 0.0
    direction: Literal[1, -1] = 1
    speed_mm_s: float = 20.0
    acceleration_mm_s2: float = 100.0
    settle_s: float = 0.2
    ringing_um: float = 20.0
    ringing_hz: float = 25.0
    backlash_um: float = 5.0
    noise_um: float = 1.0


@dataclass(frozen=True, slots=True)
class Ramp:
    """A part of a movement with constant acceleration."""

    duration_s: float
    start_mm_s: float
    end_mm_s: float


def trapezoid(
    distance_mm: float, speed_mm_s: float, acceleration_mm_s2: float, start_mm_s: float = 0.0
) -> tuple[Ramp, ...]:
    """Return the ramps of a move over `distance_mm` > 0: up, along, down; no plateau if it is short."""
    start_mm_s = min(start_mm_s, speed_mm_s)
    peak_mm_s = min(speed_mm_s, math.sqrt(start_mm_s**2 + acceleration_mm_s2 * distance_mm))
    ramp_s = (peak_mm_s - start_mm_s) / acceleration_mm_s2
    plateau_mm = max(0.0, distance_mm - ramp_s * (peak_mm_s + start_mm_s))
    return (
        Ramp(ramp_s, start_mm_s, peak_mm_s),
        Ramp(plateau_mm / peak_mm_s, peak_mm_s, peak_mm_s),
        Ramp(ramp_s, peak_mm_s, start_mm_s),
    )


@dataclass(frozen=True, slots=True)
class Movement:
    """One movement of the screw from `from_mm` towards `sign`, over after `ends_after_s`."""

    start_s: float
    from_mm: float
    sign: float
    ramps: tuple[Ramp, ...]
    ends_after_s: float
    outcome: Outcome = "done"

    def travelled(self, elapsed_s: float) -> tuple[float, float]:
        """Return (distance in mm, speed in mm/s) after `elapsed_s`."""
        left_s = max(0.0, min(elapsed_s, self.ends_after_s))
        distance_mm, speed_mm_s = 0.0, 0.0
        for ramp in self.ramps:
            part_s = min(left_s, ramp.duration_s)
            if ramp.duration_s > 0:
                rate = (ramp.end_mm_s - ramp.start_mm_s) / ramp.duration_s
                speed_mm_s = ramp.start_mm_s + rate * part_s
                distance_mm += (ramp.start_mm_s + speed_mm_s) / 2 * part_s
            left_s -= part_s
            if left_s <= 0:
                break
        return distance_mm, speed_mm_s

    def position_mm(self, time_s: float) -> float:
        """Return the screw's position at a time of the world."""
        return self.from_mm + self.sign * self.travelled(time_s - self.start_s)[0]

    @property
    def end_s(self) -> float:
        """The time of the world at which the screw stops."""
        return self.start_s + self.ends_after_s

    @property
    def length_mm(self) -> float:
        """The distance that is travelled in all."""
        return self.travelled(self.ends_after_s)[0]

    def cut(self, after_mm: float, outcome: Outcome) -> "Movement":
        """Return this movement, ended abruptly after a distance."""
        # By bisection: the distance grows with time, whatever the ramps are.
        low_s, high_s = 0.0, self.ends_after_s
        for _ in range(60):
            middle_s = (low_s + high_s) / 2
            low_s, high_s = (middle_s, high_s) if self.travelled(middle_s)[0] < after_mm else (low_s, middle_s)
        return replace(self, ends_after_s=high_s, outcome=outcome)


@dataclass(slots=True)
class MoveFaults:
    """What goes wrong with the next move of an axis; a fault is spent by the move that suffers it."""

    stall_fraction: float | None = None
    limit_fraction: float | None = None
    overshoot_mm: float = 0.0
    lost_counts: float = 0.0


@dataclass(frozen=True, slots=True)
class Speed:
    """The speeds of a move: it begins and ends with the start speed and ramps up to the full one."""

    full_mm_s: float
    acceleration_mm_s2: float
    start_mm_s: float = 0.0


@dataclass(slots=True)
class _Carriage:
    """The true side: how far the load lags in its play, what was lost, and the errors that a move draws."""

    play_mm: float = 0.0
    slip_mm: float = 0.0
    next_slip_mm: float = 0.0
    noise_mm: float = 0.0
    next_noise_mm: float = 0.0
    faults: MoveFaults = field(default_factory=MoveFaults)


@dataclass(frozen=True, slots=True)
class _Past:
    """How the axis moved until `until_s`."""

    until_s: float
    movement: Movement
    carriage: _Carriage
    moved: bool


class Axis:
    """One axis: moved by its controller, asked by the world.

    Parameters
    ----------
    settings
        What the axis is like.
    clock
        The clock of the world.
    seed
        Seed of the noise of its moves.

    Attributes
    ----------
    speed
        The speed of the moves to come.
    """

    def __init__(self, settings: AxisSettings, clock: WorldClock, seed: int | tuple[int, ...] | None = None) -> None:
        low_mm, high_mm = settings.travel_mm
        if not low_mm <= settings.start_mm <= high_mm or not low_mm <= settings.home_mm <= high_mm:
            raise ValueError(f"start_mm and home_mm must lie within travel_mm {settings.travel_mm}")
        self.settings = settings
        self._clock = clock
        self._random = np.random.default_rng(seed)
        self._lock = threading.RLock()
        self.speed = Speed(settings.speed_mm_s, settings.acceleration_mm_s2)
        self._movement = Movement(clock.now(), settings.start_mm, 1.0, (), 0.0)
        self._moved = False
        self._carriage = _Carriage()
        self._past: deque[_Past] = deque(maxlen=REMEMBERED)

    @property
    def faults(self) -> MoveFaults:
        """What will go wrong with the next move."""
        return self._carriage.faults

    @property
    def controller_mm(self) -> float:
        """Where the step counter says that the axis is."""
        with self._lock:
            return self._movement.position_mm(self._clock.now())

    @property
    def busy(self) -> bool:
        """Whether the controller drives the motor: a stalled move never ends by itself."""
        with self._lock:
            return self._movement.outcome == "stalled" or self._clock.now() < self._movement.end_s

    @property
    def outcome(self) -> Outcome:
        """How the last movement ended or is going to end."""
        return self._movement.outcome

    def move_to(self, target_mm: float, speed: Speed | None = None) -> None:
        """Start a move of the step counter to a position, at `speed` or the one that is set.

        Whatever movement was under way ends where it is.
        """
        with self._lock:
            self._come_to_rest()
            from_mm = self._movement.from_mm
            faults, self._carriage.faults = self._carriage.faults, MoveFaults()
            sign = math.copysign(1.0, target_mm - from_mm)
            distance_mm = abs(target_mm - from_mm) + faults.overshoot_mm
            if distance_mm <= 0:
                return
            speed = speed or self.speed
            ramps = trapezoid(distance_mm, speed.full_mm_s, speed.acceleration_mm_s2, speed.start_mm_s)
            movement = Movement(self._clock.now(), from_mm, sign, ramps, sum(r.duration_s for r in ramps))
            self._start(self._limited(movement, faults), faults)

    def stop(self, *, at_once: bool = False) -> None:
        """Stop: with the set deceleration, or at once."""
        with self._lock:
            now_s = self._clock.now()
            if not self.busy:
                return
            movement = self._movement
            speed_mm_s = 0.0
            if movement.outcome != "stalled":
                speed_mm_s = movement.travelled(now_s - movement.start_s)[1]
            rest_mm_s = min(self.speed.start_mm_s, speed_mm_s)
            ramp = Ramp((speed_mm_s - rest_mm_s) / self.speed.acceleration_mm_s2, speed_mm_s, rest_mm_s)
            self._come_to_rest()
            ramps = () if at_once else (ramp,)
            ends_after_s = 0.0 if at_once else ramp.duration_s
            stopping = Movement(now_s, self._movement.from_mm, movement.sign, ramps, ends_after_s, "stopped")
            self._moved = True
            self._movement = self._limited(stopping, MoveFaults())

    def home(self, speed: Speed | None = None) -> None:
        """Go to the origin sensor: from there on the step counter agrees with the true position again.

        A fault of the next move that would belie the sensor (overshoot, lost steps) is left for the move after it.
        """
        with self._lock:
            self._come_to_rest()
            carriage = self._carriage
            self._movement = replace(self._movement, from_mm=self._movement.from_mm + carriage.slip_mm)
            carriage.slip_mm = carriage.next_slip_mm = 0.0
            faults = carriage.faults
            carriage.faults = replace(faults, overshoot_mm=0.0, lost_counts=0.0)
            self.move_to(self.settings.home_mm, speed)
            carriage.faults.overshoot_mm, carriage.faults.lost_counts = faults.overshoot_mm, faults.lost_counts

    @property
    def true_mm(self) -> float:
        """Where the carriage is now."""
        return self.true_mm_at(self._clock.now())

    def true_mm_at(self, time_s: float) -> float:
        """Where the carriage was at a time that is not long over, or is now."""
        with self._lock:
            then = next((past for past in self._past if time_s < past.until_s), None)
            return self._true_mm(time_s, then or _Past(math.inf, self._movement, self._carriage, self._moved))

    def _start(self, movement: Movement, faults: MoveFaults) -> None:
        carriage, settings = self._carriage, self.settings
        lost_mm = faults.lost_counts / settings.counts_per_mm
        carriage.next_slip_mm = carriage.slip_mm - movement.sign * lost_mm
        carriage.next_noise_mm = float(self._random.normal(0.0, settings.noise_um / 1000))
        self._moved = True
        self._movement = movement

    def _limited(self, movement: Movement, faults: MoveFaults) -> Movement:
        """End a movement where it stalls or at the first limit switch."""
        length_mm = movement.length_mm
        screw_mm = movement.from_mm + self._carriage.slip_mm
        low_mm, high_mm = self.settings.travel_mm
        room_mm = high_mm - screw_mm if movement.sign > 0 else screw_mm - low_mm
        if faults.limit_fraction is not None:
            room_mm = min(room_mm, faults.limit_fraction * length_mm)
        if faults.stall_fraction is not None and faults.stall_fraction * length_mm < room_mm:
            return movement.cut(faults.stall_fraction * length_mm, "stalled")
        # A billionth of a millimetre: rounding must not make a limit of a move that ends at the end of the
        # travel.
        if length_mm > room_mm + 1e-9:
            return movement.cut(max(0.0, room_mm), "limit")
        return movement

    def _come_to_rest(self) -> None:
        """Make the present state the start of what follows."""
        now_s = self._clock.now()
        carriage, movement = self._carriage, self._movement
        self._past.append(_Past(now_s, movement, replace(carriage), self._moved))
        fraction = _fraction(movement, now_s)
        carriage.play_mm = self._play_mm(now_s, carriage, movement)
        carriage.slip_mm += (carriage.next_slip_mm - carriage.slip_mm) * fraction
        carriage.noise_mm += (carriage.next_noise_mm - carriage.noise_mm) * fraction
        carriage.next_slip_mm, carriage.next_noise_mm = carriage.slip_mm, carriage.noise_mm
        outcome = self._movement.outcome if self._movement.outcome != "stalled" else "stopped"
        self._movement = Movement(now_s, self._movement.position_mm(now_s), 1.0, (), 0.0, outcome)
        self._moved = False

    def _play_mm(self, time_s: float, carriage: _Carriage, movement: Movement) -> float:
        """Return how far the load is ahead of the screw: pushed it sits on it, pulled it trails."""
        travelled_mm = movement.sign * movement.travelled(time_s - movement.start_s)[0]
        return min(max(carriage.play_mm - travelled_mm, 0.0), self.settings.backlash_um / 1000)

    def _true_mm(self, time_s: float, then: _Past) -> float:
        carriage, movement = then.carriage, then.movement
        fraction = _fraction(movement, time_s)
        slip_mm = carriage.slip_mm + (carriage.next_slip_mm - carriage.slip_mm) * fraction
        noise_mm = carriage.noise_mm + (carriage.next_noise_mm - carriage.noise_mm) * fraction
        at_mm = movement.position_mm(time_s) + slip_mm + self._play_mm(time_s, carriage, movement) + noise_mm
        return at_mm + (self._ringing_mm(time_s, movement) if then.moved else 0.0)

    def _ringing_mm(self, time_s: float, movement: Movement) -> float:
        settings = self.settings
        since_s = time_s - movement.end_s
        amplitude_mm = settings.ringing_um / 1000
        if since_s <= 0 or amplitude_mm <= SETTLED_MM or settings.settle_s <= 0:
            return 0.0
        peak_mm_s = max((max(ramp.start_mm_s, ramp.end_mm_s) for ramp in movement.ramps), default=0.0)
        decay_s = settings.settle_s / math.log(amplitude_mm / SETTLED_MM)
        reach_mm = amplitude_mm * min(1.0, peak_mm_s / 20.0) * math.exp(-since_s / decay_s)
        if reach_mm <= SETTLED_MM:
            return 0.0
        return movement.sign * reach_mm * math.sin(2 * math.pi * settings.ringing_hz * since_s)


def _fraction(movement: Movement, time_s: float) -> float:
    length_mm = movement.length_mm
    return 1.0 if length_mm == 0 else movement.travelled(time_s - movement.start_s)[0] / length_mm
