"""The one driver of stages on a serial line; what differs between controllers is in their dialect files."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import ClassVar

from drivers.errors import (
    DeviceLost,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    Refused,
    TimedOut,
    Unsupported,
)
from drivers.stage.axis import Scale, SerialStageSettings, resolve
from drivers.stage.controller import Controller
from drivers.stage.dialect import load_dialect
from drivers.stage.frames import Status
from drivers.stage.homing import Homing
from drivers.stage.motion import Move, Watch, begun, begun_before
from drivers.stage.port import LINE_LIMIT_S, acquire, never, release
from drivers.values import Position, StageCapabilities, StageCondition, StageState, StopAnswer, TravelLimits

# The last motions of controllers that never answer, by line and axis: each goes on to its end, whatever becomes of
# the line, and of the driver that began it. Of one that this program has not moved yet the worst is believed.
_unseen: dict[tuple[str, int], Move] = {}


class SerialStage:
    """One axis of a stage controller on a serial line (a `drivers.protocols.Stage`).

    Parameters
    ----------
    name
        Name in the rig file.
    settings
        The axis, its line and its dialect.

    Raises
    ------
    ConfigurationError
        The dialect cannot be read, or a fact of the axis is missing.
    """

    Settings: ClassVar = SerialStageSettings

    def __init__(self, name: str, settings: SerialStageSettings) -> None:
        self._name = name
        self._axis = resolve(name, settings, load_dialect(settings.dialect, device=name))
        self._drive = self._axis.drive(settings.speed_mm_per_s)
        self._controller: Controller | None = None
        self._generation = 0
        self._scale: Scale | None = None
        self._counts = 0
        self._rested_at: int | None = None
        self._move: Move | None = None
        self._target_mm: float | None = None
        self._failure: InstrumentError | None = None
        self._stopped = threading.Event()
        self._operation = threading.Lock()
        self._starting = threading.Lock()
        self._joining = threading.Lock()

    @property
    def name(self) -> str:
        """Name in the rig file."""
        return self._name

    # --- connection

    def open(self) -> None:
        """Open the line, end a motion that is going on, and set the speed; the axis then has no zero.

        A motion that can be neither asked for nor ended is waited for by whatever comes next: see `moving_at_open_s`.

        Raises
        ------
        NotConnected
            The port cannot be opened, or nothing answers there.
        ConfigurationError
            The port is shared with an axis that it cannot be shared with.
        """
        with self._exclusively():
            if self._controller is not None:
                return
            axis = self._axis
            port = acquire(self._name, axis.settings.port, axis.line, axis=axis.settings.axis, alone=axis.alone)
            self._controller = Controller(axis, port)
            self._generation = 0
            self._stopped.clear()
            if not self._controller.reads_position:
                _unseen.setdefault(self._place, begun_before(axis, self._drive))
            try:
                self._connected(patience_s=0.0)
            except BaseException as error:
                self._controller = None
                release(self._name, port)
                if isinstance(error, TimedOut):
                    raise NotConnected(self._name, error.what, error.remedy) from None
                raise

    def close(self) -> None:
        """Stop the motion where that can be done, and give the line back; never raises."""
        self._stopped.set()
        controller = self._controller
        if controller is None:
            return
        if self._axis.dialect.actions.stop is not None and self._move is not None:
            with suppress(InstrumentError):
                controller.stop()
                self._move = None
        # Whoever is inside an operation leaves it soon: each looks at `_stopped`.
        inside = self._operation.acquire(timeout=LINE_LIMIT_S)
        self._controller = None
        self._scale = None
        release(self._name, controller.port)
        if inside:
            self._operation.release()

    def capabilities(self) -> StageCapabilities:
        """Tell what this axis can do."""
        return self._axis.capabilities()

    # --- zero

    def home(self) -> Position:
        """Find the axis's own zero; returns when it stands there.

        Raises
        ------
        Unsupported
            The controller cannot.
        TimedOut, MotionFailed, LimitReached
            It does not end, not at zero, or nothing is seen to move (`drivers.stage.homing`).
        """
        with self._exclusively():
            self._stopped.clear()
            controller = self._connected(patience_s=self._axis.settings.reconnect_s)
            if self._axis.dialect.actions.home is None:
                raise Unsupported(
                    self._name,
                    f"a {self._axis.dialect.title} cannot home",
                    "bring the stage to a known place by hand, then zero it there",
                )
            self._refuse_while_moving(controller)
            self._scale = self._failure = self._target_mm = None
            # `close` and `state` must know of the motion while it lasts.
            self._move = Move(0, 0, time.monotonic(), 0.0, self._axis.settings.home_timeout_s)
            try:
                counts = Homing(self._axis, controller, self._drive, self._stopped, self._starting).find()
            except InstrumentError as error:
                self._failure = error
                raise
            finally:
                self._move = None
            self._rested_at = counts
            self._scale = self._axis.scale(self._axis.settings.home_position_mm)
            return Position(self._scale.to_mm(counts), measured=True)

    def zero(self, position_mm: float, *, confirmed_by: str) -> Position:
        """Call the present place `position_mm`, on the word of the person `confirmed_by`; nothing moves.

        Raises
        ------
        Refused
            Nobody confirms it, it lies outside the soft limits, or the axis moves.
        """
        if not confirmed_by.strip():
            raise Refused(self._name, "nobody confirms the zero", "look at the stage and give a name")
        self._axis.check_position(position_mm)
        with self._exclusively():
            controller = self._connected(patience_s=self._axis.settings.reconnect_s)
            self._refuse_while_moving(controller)
            self._scale = self._failure = self._target_mm = self._move = None
            controller.zero()
            self._counts = controller.status().counts if controller.reads_position else 0
            self._rested_at = self._counts
            unscaled = self._axis.scale(0.0)
            self._scale = self._axis.scale(position_mm - unscaled.to_mm(self._counts))
            return Position(position_mm, measured=controller.reads_position)

    # --- motion

    def move_to(self, position_mm: float) -> None:
        """Start an absolute move; returns when it has begun.

        Raises
        ------
        LimitReached
            Outside the soft limits; nothing was sent.
        Refused
            No zero since `open` or since the line was lost; still moving; refused by the controller.
        MotionFailed
            Stopped before it began.
        """
        with self._exclusively():
            self._stopped.clear()
            self._axis.check_position(position_mm)
            controller = self._connected(patience_s=self._axis.settings.reconnect_s)
            scale = self._zeroed()
            self._refuse_while_moving(controller)
            status = controller.status() if controller.reads_position else None
            start = status.counts if status else self._counts
            self._check_rest(start)
            target = scale.to_counts(position_mm)
            self._failure, self._target_mm, self._rested_at = None, position_mm, None
            at_limit = status is not None and status.at_limit
            if start == target:
                self._move = begun(self._axis, self._drive, start, target, at_limit=at_limit)
            else:
                self._start(controller, start, target, at_limit=at_limit)

    def wait(self, timeout_s: float | None = None) -> Position:
        """Wait for the end of the move, within `timeout_s` or within the axis's own bound for it.

        Without read-back the end is computed from distance, speed, ramp and settle time, and the position is
        marked as not measured.

        Raises
        ------
        TimedOut
            It still moves.
        MotionFailed
            No progress, stopped, or outside the in-position window.
        LimitReached
            A limit switch ended it.
        DeviceLost
            The line went away.
        """
        controller = self._connected(patience_s=0.0)
        move, failure = self._move, self._failure
        if failure is not None:
            raise type(failure)(failure.device, failure.what, failure.remedy)
        if move is None:
            return self.position()
        scale = self._zeroed()
        try:
            if controller.reads_position:
                reached = self._watch(controller).follow(move, scale, timeout_s)
            else:
                self._watch(controller).sit_out(move, timeout_s)
                reached = move.target_counts
        except (MotionFailed, LimitReached, DeviceLost) as error:
            self._failure, self._move = error, None
            raise
        self._move, self._rested_at = None, reached
        return Position(scale.to_mm(reached), controller.reads_position)

    def stop(self) -> StopAnswer:
        """End the motion, from any thread; where the controller cannot, tell when it ends by itself.

        A move whose starting command has not been sent is cancelled, whatever the controller can do.

        Raises
        ------
        InstrumentError
            The controller could not be told, or still moves: look at the stage.
        """
        self._stopped.set()
        controller = self._controller
        if controller is None or self._axis.dialect.actions.stop is None:
            # A move that is being started leaves this at once, either sent or cancelled.
            with self._starting:
                move = self._move
            left_s = max(self._unseen_left_s(), 0.0 if move is None else move.left_s())
            return StopAnswer(stopped=left_s == 0.0, ends_in_s=left_s)
        controller.port.connect(self._name, patience_s=0.0, cancelled=never)
        if controller.reads_position:
            self._watch(controller).halt()
            return StopAnswer(stopped=True)
        # Told, but nobody hears whether it obeys, or where it came to rest.
        controller.stop()
        with self._starting:
            left_s = self._unseen_left_s()
        if left_s > 0.0:
            self._scale = None
        return StopAnswer(stopped=left_s == 0.0, ends_in_s=left_s)

    def position(self) -> Position:
        """Tell where the axis is now, measured where the controller tells it.

        Raises
        ------
        Refused
            There is no zero yet.
        """
        controller = self._connected(patience_s=self._axis.settings.reconnect_s)
        self._zeroed()
        return self._position(controller, controller.status() if controller.reads_position else None)

    # --- settings and state

    def preview(self, distance_mm: float) -> tuple[bytes, ...]:
        """Show the frames of a move by `distance_mm` from the axis's zero counts; nothing is sent.

        For a first contact with a box whose dialect is unverified.

        Raises
        ------
        Refused
            Too far for one command.
        """
        return self._axis.preview(self._axis.scale(0.0).to_counts(distance_mm), self._drive)

    def set_speed(self, speed_mm_per_s: float) -> float:
        """Set the speed of later moves; returns the nearest that the controller has, which is now in force.

        Raises
        ------
        Refused
            Out of range, or moving.
        """
        drive = self._axis.drive(speed_mm_per_s)
        with self._exclusively():
            controller = self._connected(patience_s=self._axis.settings.reconnect_s)
            self._refuse_while_moving(controller)
            controller.set_speed(drive)
            self._drive = drive
        return drive.speed_mm_per_s

    def limits(self) -> TravelLimits:
        """Tell the soft limits."""
        return TravelLimits(*self._axis.settings.limits_mm)

    def state(self) -> StageState:
        """Tell what the axis is doing; never raises."""
        if self._controller is None:
            return self._told(StageCondition.CLOSED, None)
        try:
            controller = self._connected(patience_s=0.0)
            status = controller.status() if controller.reads_position else None
            position = None if self._scale is None else self._position(controller, status)
            return self._told(self._condition(status), position)
        except (DeviceLost, NotConnected):
            return self._told(StageCondition.LOST, None)
        except InstrumentError:
            return self._told(StageCondition.FAILED, None)

    # --- inside

    @property
    def _place(self) -> tuple[str, int]:
        return self._axis.settings.port, self._axis.settings.axis

    def _unseen_left_s(self) -> float:
        move = _unseen.get(self._place)
        return 0.0 if move is None else move.left_s()

    def _condition(self, status: Status | None) -> StageCondition:
        moving = status.busy if status else self._unseen_left_s() > 0.0
        if moving:
            return StageCondition.MOVING
        if status is not None and status.at_limit:
            return StageCondition.AT_LIMIT
        if self._scale is None:
            return StageCondition.NO_ZERO
        return StageCondition.READY if self._failure is None else StageCondition.FAILED

    def _told(self, condition: StageCondition, position: Position | None) -> StageState:
        return StageState(condition, position, self._target_mm, self._drive.speed_mm_per_s)

    def _position(self, controller: Controller, status: Status | None) -> Position:
        scale = self._zeroed()
        if status is not None:
            return Position(scale.to_mm(status.counts), measured=True)
        controller.port.check(self._name)
        move = self._move
        return Position(scale.to_mm(move.estimate() if move else self._counts), measured=False)

    def _start(self, controller: Controller, start: int, target: int, *, at_limit: bool) -> None:
        counts = target if self._axis.dialect.motion == "absolute" else target - start
        with self._starting:
            try:
                sent = controller.move(counts, self._drive, self._stopped.is_set)
            except InstrumentError as error:
                self._failure = error
                if not controller.reads_position:
                    # Whether the stage moves is not known, and nobody can ask: it may.
                    self._scale = None
                    _unseen[self._place] = begun(self._axis, self._drive, start, target)
                raise
            if sent:
                # Known to `stop` before it may look: it waits for `_starting`.
                self._move = begun(self._axis, self._drive, start, target, at_limit=at_limit)
                if not controller.reads_position:
                    _unseen[self._place] = self._move
                self._counts = target
                return
        self._failure = MotionFailed(self._name, "stopped before the move began", "move again")
        raise self._failure

    def _watch(self, controller: Controller) -> Watch:
        return Watch(self._axis, controller, self._stopped)

    def _zeroed(self) -> Scale:
        scale = self._scale
        if scale is None:
            how = "home it" if self._axis.dialect.actions.home else "zero it at a known place"
            raise Refused(self._name, "the axis has no zero since it was opened or came back", how)
        return scale

    def _check_rest(self, counts: int) -> None:
        """A controller that was switched off and on keeps its line, but not its counts."""
        if self._rested_at is not None and abs(counts - self._rested_at) > self._axis.window_counts:
            self._scale = None
            raise Refused(
                self._name,
                f"the controller's counts changed from {self._rested_at} to {counts} while the axis stood still",
                "it was switched off, or moved by hand: home or zero the axis again",
            )

    def _refuse_while_moving(self, controller: Controller) -> None:
        if controller.reads_position:
            if controller.busy():
                raise Refused(self._name, "the axis still moves", "wait for it, or stop it")
        elif (left_s := self._unseen_left_s()) > 0.0:
            raise Refused(self._name, "the axis still moves, or may: nobody can ask it", f"wait {left_s:.1f} s")

    def _connected(self, *, patience_s: float) -> Controller:
        controller = self._controller
        if controller is None:
            raise NotConnected(self._name, "the stage is not open", "open it first")
        port = controller.port
        port.connect(self._name, patience_s=patience_s, cancelled=self._stopped.is_set)
        with self._joining:
            if port.generation != self._generation:
                self._join(controller)
                self._generation = port.generation
        return controller

    def _join(self, controller: Controller) -> None:
        """Bring a controller that was just found, or found again, into a known state."""
        if self._move is not None:
            self._failure = DeviceLost(
                self._name, "the line was lost during the move", "home or zero the axis, then move again"
            )
        self._scale = self._move = None
        if controller.reads_position:
            if controller.busy() and self._axis.dialect.actions.stop is not None:
                self._watch(controller).halt()
            controller.status()
            controller.set_speed(self._drive)

    @contextmanager
    def _exclusively(self) -> Iterator[None]:
        if not self._operation.acquire(blocking=False):
            raise Refused(self._name, "another operation is under way", "wait for its end, or stop it")
        try:
            yield
        finally:
            self._operation.release()
