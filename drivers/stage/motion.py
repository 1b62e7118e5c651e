"""One move of an axis: where it should be at a time, and how it is watched until it has ended."""

import threading
import time
from contextlib import suppress
from dataclasses import dataclass

from drivers.errors import GarbledReply, InstrumentError, LimitReached, MotionFailed, TimedOut
from drivers.stage.axis import Axis, Drive, Scale
from drivers.stage.controller import Controller
from drivers.stage.frames import Status

POLL_S = 0.03
# A controller may accept a move a little before it reports itself busy.
START_S = 0.3
STOP_S = 3.0


@dataclass(frozen=True, slots=True)
class Move:
    """A move that was started.

    Attributes
    ----------
    began_s
        `time.monotonic()` when its last command was sent.
    cruise_s
        Its distance at the nominal speed.
    lasts_s
        From its beginning until it must have ended and settled, if all goes as it should.
    began_at_limit
        Whether it leaves a limit switch.
    """

    start_counts: int
    target_counts: int
    began_s: float
    cruise_s: float
    lasts_s: float
    began_at_limit: bool = False

    def left_s(self) -> float:
        """Seconds until it must have ended; 0 when that is past."""
        return max(0.0, self.began_s + self.lasts_s - time.monotonic())

    def estimate(self) -> float:
        """Return the counts that it should have reached by now, at the nominal speed."""
        elapsed_s = time.monotonic() - self.began_s
        if self.left_s() == 0.0 or elapsed_s >= self.cruise_s:
            return self.target_counts
        part = max(0.0, elapsed_s) / self.cruise_s
        return self.start_counts + part * (self.target_counts - self.start_counts)


def begun(axis: Axis, drive: Drive, start: int, target: int, *, at_limit: bool = False) -> Move:
    """Describe a move that begins now."""
    settings = axis.settings
    if start == target:
        return Move(start, target, time.monotonic(), 0.0, 0.0, at_limit)
    cruise_s = abs(target - start) / axis.counts_per_mm / drive.speed_mm_per_s
    # A controller that needs silence after its last command is not believed to be done before that is over.
    silence_s = axis.dialect.actions.move[-1].pause_s
    lasts_s = max(cruise_s + axis.ramp_s, silence_s) + settings.settle_s
    return Move(start, target, time.monotonic(), cruise_s, lasts_s, at_limit)


def begun_before(axis: Axis, drive: Drive) -> Move:
    """Describe what may be under way, begun by an earlier program, in a controller that cannot be asked."""
    settings = axis.settings
    lasts_s = settings.moving_at_open_s
    if lasts_s is None:
        lower_mm, upper_mm = settings.limits_mm
        lasts_s = (upper_mm - lower_mm) / drive.speed_mm_per_s + axis.ramp_s + settings.settle_s
    return Move(0, 0, time.monotonic(), lasts_s, lasts_s)


class Watch:
    """Follows the moves of one axis through what its controller tells, or by computed time."""

    def __init__(self, axis: Axis, controller: Controller, stopped: threading.Event) -> None:
        self._axis = axis
        self._device = axis.device
        self._settings = axis.settings
        self._controller = controller
        self._stopped = stopped

    def sit_out(self, move: Move, timeout_s: float | None) -> None:
        """Wait until a move must have ended, as computed; the line must stay.

        Raises
        ------
        TimedOut
            `timeout_s` is shorter than that.
        DeviceLost
            The line went away: nobody knows where the stage is.
        MotionFailed
            It was told to stop: the same.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            self._controller.port.check(self._device)
            if self._stopped.is_set() and self._axis.dialect.actions.stop is not None:
                raise MotionFailed(self._device, "the motion was stopped", "look where the stage is, and zero it there")
            left_s = move.left_s()
            if left_s == 0.0:
                return
            if end_s is not None and time.monotonic() >= end_s:
                raise self._still_moving(f"for another {left_s:.1f} s, as computed")
            time.sleep(min(left_s, POLL_S))

    def follow(self, move: Move, scale: Scale, timeout_s: float | None) -> int:
        """Watch a move until it has ended and settled in its window; returns the counts that were read.

        Raises
        ------
        TimedOut
            It still moves.
        LimitReached
            A limit switch ended it.
        MotionFailed
            Stopped, without progress, or ended elsewhere.
        """
        bound_s = 2.0 * move.lasts_s + START_S + STOP_S if timeout_s is None else timeout_s
        now_s = time.monotonic()
        end_s, changed_s, counts = now_s + bound_s, now_s, None
        while True:
            status = self.read()
            now_s = time.monotonic()
            if status.counts != counts:
                counts, changed_s = status.counts, now_s
            self._check_limit(move, scale, status)
            if not status.busy and self._in_window(move, status):
                return self._settled(move, scale)
            if not status.busy and now_s - move.began_s > START_S:
                raise self._ended_elsewhere(move, scale, status)
            if now_s - changed_s > self._settings.progress_timeout_s:
                self.halt_quietly()
                raise self.without_progress(f"{scale.to_mm(status.counts):.3f} mm")
            if now_s >= end_s:
                raise self._still_moving(f"at {scale.to_mm(status.counts):.3f} mm after {bound_s:.1f} s")
            self._stopped.wait(POLL_S)

    def until_idle(self, bound_s: float) -> None:
        """Wait until the controller says that nothing moves.

        Raises
        ------
        TimedOut
            It still moves after `bound_s`.
        """
        end_s = time.monotonic() + bound_s
        while self._controller.busy():
            if time.monotonic() >= end_s:
                raise self._still_moving(f"after {bound_s:.1f} s")
            time.sleep(POLL_S)

    def read(self) -> Status:
        """Ask for the status; raises MotionFailed where the motion was stopped."""
        if self._stopped.is_set():
            raise MotionFailed(self._device, "the motion was stopped", "look why, then move again")
        return self._controller.status()

    def halt(self) -> None:
        """Tell the controller to stop, and wait until nothing moves.

        Raises
        ------
        InstrumentError
            It could not be told, also the second time, or still moves.
        """
        try:
            self._controller.stop()
        except (GarbledReply, TimedOut):
            # One bad answer is no reason to let a stage run on.
            self._controller.stop()
        self.until_idle(STOP_S)

    def halt_quietly(self) -> None:
        """Stop the motion if that can be done; what went wrong before is what the caller is told."""
        if self._axis.dialect.actions.stop is not None:
            with suppress(InstrumentError):
                self.halt()

    def without_progress(self, where: str) -> MotionFailed:
        """Make the error of a motion that gets no further."""
        return MotionFailed(
            self._device,
            f"no progress for {self._settings.progress_timeout_s:g} s at {where}",
            "look for what blocks the stage, then move again or home it",
        )

    def _settled(self, move: Move, scale: Scale) -> int:
        self._stopped.wait(self._settings.settle_s)
        status = self.read()
        if status.busy or not self._in_window(move, status):
            raise self._ended_elsewhere(move, scale, status)
        return status.counts

    def _check_limit(self, move: Move, scale: Scale, status: Status) -> None:
        if not status.at_limit or self._in_window(move, status):
            return
        if status.busy and move.began_at_limit:
            return
        if not status.busy and move.began_at_limit and time.monotonic() - move.began_s <= START_S:
            return
        if status.busy:
            self.halt_quietly()
        raise LimitReached(
            self._device,
            f"a limit switch ended the move at {scale.to_mm(status.counts):.3f} mm",
            "move away from the limit; correct limits_mm if it lies inside them",
        )

    def _in_window(self, move: Move, status: Status) -> bool:
        return abs(status.counts - move.target_counts) <= self._axis.window_counts

    def _ended_elsewhere(self, move: Move, scale: Scale, status: Status) -> MotionFailed:
        reached_mm, target_mm = scale.to_mm(status.counts), scale.to_mm(move.target_counts)
        return MotionFailed(
            self._device,
            f"the move ended at {reached_mm:.4f} mm, {reached_mm - target_mm:+.4f} mm from its target"
            f" (window {self._settings.in_position_mm:g} mm)",
            "look for what blocks the stage, then move again or home it",
        )

    def _still_moving(self, where: str) -> TimedOut:
        return TimedOut(self._device, f"still moving {where}", "wait longer, or stop it")
