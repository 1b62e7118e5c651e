"""Finding an axis's own zero, with a controller that is not believed unless something is seen to move."""

import threading
import time

from drivers.errors import MotionFailed, TimedOut
from drivers.stage.axis import Axis, Drive
from drivers.stage.controller import Controller
from drivers.stage.frames import Status
from drivers.stage.motion import POLL_S, START_S, Watch, begun

# A way that every stage has inside its limits, and that no in-position window hides.
CHECK_MM = 0.5


class Homing:
    """Homes one axis.

    After power-up a controller shows 0 counts wherever the stage stands: one that accepts the command and is never
    seen to move may have done nothing.

    Parameters
    ----------
    axis, controller, drive
        What homes, and at which speed it is moved otherwise.
    stopped
        Set from any thread to end it.
    starting
        Held while a command is sent.
    """

    def __init__(
        self, axis: Axis, controller: Controller, drive: Drive, stopped: threading.Event, starting: threading.Lock
    ) -> None:
        self._axis = axis
        self._controller = controller
        self._drive = drive
        self._stopped = stopped
        self._starting = starting
        self._watch = Watch(axis, controller, stopped)

    def find(self) -> int:
        """Home; returns the counts that were read at the zero.

        Where nothing was seen to move, the axis is moved a little to the inside of its limits, and homed again.

        Raises
        ------
        TimedOut
            It takes longer than its bound.
        MotionFailed, LimitReached
            Stopped, without progress, or ended elsewhere; or the axis does not move at all.
        """
        away = abs(self._controller.status().counts) > self._axis.window_counts
        status, moved = self._once()
        if away or moved:
            return status.counts
        self._leave(status)
        return self._once()[0].counts

    def _once(self) -> tuple[Status, bool]:
        """Home once; returns the status that was read at the end, and whether anything was seen to move."""
        device, settings = self._axis.device, self._axis.settings
        with self._starting:
            if not self._controller.home(self._stopped.is_set):
                raise MotionFailed(device, "stopped before homing began", "home again")
        began_s = moved_s = time.monotonic()
        status = self._watch.read()
        first = counts = status.counts
        moved = status.busy
        while status.busy or time.monotonic() - began_s < START_S:
            if status.counts != counts:
                counts, moved_s = status.counts, time.monotonic()
            # A controller that does not count while it homes is given the whole bound.
            if status.busy and counts != first and time.monotonic() - moved_s > settings.progress_timeout_s:
                self._watch.halt_quietly()
                raise self._watch.without_progress(f"{counts} counts, while homing")
            if time.monotonic() - began_s >= settings.home_timeout_s:
                self._watch.halt_quietly()
                raise TimedOut(
                    device,
                    f"homing has not ended within {settings.home_timeout_s:g} s",
                    "check the home switch, then home again; or raise home_timeout_s",
                )
            self._stopped.wait(POLL_S)
            status = self._watch.read()
            moved = moved or status.busy or status.counts != first
        self._stopped.wait(settings.settle_s)
        status = self._watch.read()
        if status.busy or abs(status.counts) > self._axis.window_counts:
            raise MotionFailed(
                device, f"homing ended at {status.counts} counts, not at 0", "check the switch, home again"
            )
        return status, moved

    def _leave(self, status: Status) -> None:
        """Move away from where homing ended, towards the middle of the limits."""
        axis, home_mm = self._axis, self._axis.settings.home_position_mm
        scale = axis.scale(home_mm)
        inside = 1.0 if sum(axis.settings.limits_mm) / 2.0 >= home_mm else -1.0
        target = scale.to_counts(home_mm + inside * max(CHECK_MM, 4.0 * axis.settings.in_position_mm))
        with self._starting:
            told = target if axis.dialect.motion == "absolute" else target - status.counts
            if not self._controller.move(told, self._drive, self._stopped.is_set):
                raise MotionFailed(axis.device, "stopped before it moved", "home again")
        # Its zero may lie on its limit switch.
        move = begun(axis, self._drive, status.counts, target, at_limit=status.at_limit)
        self._watch.follow(move, scale, None)
