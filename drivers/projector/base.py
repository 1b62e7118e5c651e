"""What every projector driver is: patterns from some source, one light, stopped from any thread, dark after errors."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, InstrumentError, NotConnected, Refused, Unsupported
from drivers.projector.gate import Gate, check_index, check_patterns, check_sequence
from drivers.projector.source import PatternSource
from drivers.values import (
    Led,
    PatternSequence,
    ProjectorCapabilities,
    ProjectorCondition,
    ProjectorStatus,
    StopAnswer,
    SyncOutput,
    check_intensity,
)

CLOSE_LIMIT_S = 5.0


class PatternProjector(ABC):
    """A projector (`drivers.protocols.Projector`), but for what differs between boxes.

    A subclass reaches its box only inside `_talking`, so that calls follow one another, a stopped operation
    sends nothing more, and an error that comes from the box turns its light off.

    Parameters
    ----------
    name
        Name in the rig file.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._gate = Gate(name)
        self._line = threading.RLock()
        self._opened = False
        self._failed = False
        self._unstoppable = False
        self._light: tuple[Led, float] | None = None
        self._darkened = False
        self._sequence: PatternSequence | None = None
        self._next = 0
        self._condition = ProjectorCondition.CLOSED
        self._shown: int | None = None

    @property
    def name(self) -> str:
        """Name in the rig file."""
        return self._name

    # --- what a subclass has to say

    @property
    @abstractmethod
    def _source(self) -> PatternSource:
        """Where patterns come from."""

    @property
    @abstractmethod
    def _reached(self) -> bool:
        """Whether the box is connected, as far as is known."""

    @abstractmethod
    def _reach(self) -> None:
        """Connect, and make the box dark and its LEDs off."""

    @abstractmethod
    def _release(self) -> None:
        """Disconnect; never raises, may be repeated."""

    @abstractmethod
    def _light_off(self) -> None:
        """Turn all LEDs off, whatever happened before, and stop the display."""

    @abstractmethod
    def _set_light(self, led: Led, intensity: float) -> None:
        """Light one LED."""

    @abstractmethod
    def _set_sync(self, sync: SyncOutput) -> None:
        """Set the pulse for the camera."""

    @abstractmethod
    def _set_parked(self, *, parked: bool) -> None:
        """Park or unpark the mirrors."""

    @abstractmethod
    def _check_health(self) -> None:
        """Raise DeviceFault if the box reports a fault."""

    @abstractmethod
    def capabilities(self) -> ProjectorCapabilities:
        """Tell what the projector can do."""

    @abstractmethod
    def _read_status(self) -> ProjectorStatus:
        """Ask the box what it is doing."""

    # --- connection

    def open(self) -> None:
        """Connect; the projector is then dark, its LEDs off, nothing loaded.

        Raises
        ------
        NotConnected
            It is not there, or may not be used.
        ConfigurationError
            The settings cannot be right, whatever is plugged in.
        """
        with self._gate.operation(), self._line:
            if not (self._opened and self._reached):
                self._join()
            self._opened = True

    def close(self) -> None:
        """Turn the light off and disconnect; never raises, may be repeated."""
        with self._gate.stopping():
            self._gate.drain(CLOSE_LIMIT_S)
            with self._line:
                if self._opened and self._reached:
                    with suppress(InstrumentError):
                        self._light_off()
                self._opened = False
                self._release()
                self._forget(ProjectorCondition.CLOSED)

    def stop(self) -> StopAnswer:
        """End what is going on: the projector shows nothing any more; from any thread, at any time.

        Raises
        ------
        InstrumentError
            The box could not be told: look at it.
        """
        with self._gate.stopping(), self._line:
            if self._opened:
                if self._reached:
                    with self._talking(always=True):
                        self._source.dark()
                else:
                    self._join()
                self._now(ProjectorCondition.DARK, None)
                self._next = 0
        return StopAnswer(stopped=True)

    # --- patterns

    def load(self, patterns: NDArray[np.uint8]) -> None:
        """Replace the loaded patterns by `patterns`, (n, H, W).

        Raises
        ------
        Unsupported
            The box takes none (they lie in its flash).
        Refused
            Wrong shape or type, too many, a sequence is running, or stopped meanwhile.
        """
        capabilities = self.capabilities()
        if capabilities.can_load:
            patterns = check_patterns(self._name, patterns, capabilities.size_px, capabilities.pattern_limit)
        with self._operation():
            self._refuse_while_running()
            self._sequence, self._next = None, 0
            self._source.load(patterns)
            if self._condition is not ProjectorCondition.PARKED:
                self._now(ProjectorCondition.DARK, None)

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Set the sequence that `step`, `run_once` and `repeat` follow, and tell the times that are in force.

        Raises
        ------
        Refused
            An index that is not loaded, a time that this projector cannot keep, or a sequence is running.
        """
        with self._operation():
            check_sequence(self._name, sequence, self._source.count(sequence.bits))
            self._refuse_while_running()
            self._sequence, self._next = None, 0
            self._sequence = self._source.order(sequence)
            if self._condition is not ProjectorCondition.PARKED:
                self._now(ProjectorCondition.DARK, None)
            return self._sequence

    def show(self, index: int) -> None:
        """Show one loaded pattern and leave it on; returns when its light is there.

        Raises
        ------
        Refused
            Not loaded, parked, or the light is off since an error.
        """
        with self._operation():
            check_index(self._name, index, self._source.count(self._sequence.bits if self._sequence else 8))
            self._refuse_dark()
            self._source.show(index)
            self._now(ProjectorCondition.SHOWING, index)
            self._check_health()

    def step(self) -> int | None:
        """Show the next pattern of the order; returns its index, or None after the last (dark then).

        Raises
        ------
        Refused
            No order, parked, or the light is off since an error.
        """
        with self._operation():
            order = self._ordered().order
            self._refuse_dark()
            if self._next == len(order):
                self._dark()
                self._next = 0
                self._now(ProjectorCondition.DARK, None)
                return None
            index = order[self._next]
            self._source.show_position(self._next)
            self._next += 1
            self._now(ProjectorCondition.SHOWING, index)
            self._check_health()
            return index

    def run_once(self) -> None:
        """Start the order once; returns when it has started; raises as `step`."""
        self._run(repeat=False)

    def repeat(self) -> None:
        """Start the order over and over, until `stop`; returns when it has started; raises as `step`."""
        self._run(repeat=True)

    # --- light, sync, park

    def set_led(self, led: Led, intensity: float) -> None:
        """Light one LED, all others off; 0 is off.

        Raises
        ------
        Refused
            Above the highest intensity that is allowed.
        Unsupported
            There is no such LED under software's control.
        DeviceFault
            The box reports a fault; its LEDs are off.
        """
        check_intensity(self._name, intensity)
        with self._operation():
            self._set_light(led, intensity)
            self._light = (led, intensity) if intensity > 0.0 else None
            self._darkened = False
            # Off is off, whatever else is wrong: a box that was too hot says so until it is lit again.
            if intensity > 0.0:
                self._check_health()

    def configure_sync(self, sync: SyncOutput) -> None:
        """Set the pulse for the camera.

        Raises
        ------
        Unsupported
            There is no such output.
        Refused
            Times that it cannot keep, or a sequence is running.
        """
        with self._operation():
            self._refuse_while_running()
            self._set_sync(sync)

    def park(self) -> None:
        """Park the mirrors for transport or long rest; dark, LED off."""
        with self._operation():
            with self._talking():
                self._light_off()
            self._light = None
            self._set_parked(parked=True)
            self._now(ProjectorCondition.PARKED, None)

    def unpark(self) -> None:
        """Make ready again after `park`; dark, LED off."""
        with self._operation():
            self._set_parked(parked=False)
            self._now(ProjectorCondition.DARK, None)

    def status(self) -> ProjectorStatus:
        """Tell what the projector is doing; also while an operation is under way."""
        if not self._opened:
            return ProjectorStatus(ProjectorCondition.CLOSED, None, None, None, None)
        try:
            with self._line:
                if not self._reached:
                    self._join()
                with self._talking(always=True):
                    return self._read_status()
        except InstrumentError:
            self._secure()
            raise

    # --- inside

    @contextmanager
    def _talking(self, *, always: bool = False) -> Iterator[None]:
        """Hold the line to the box; nothing is sent for an operation that was stopped."""
        with self._line:
            outer, self._unstoppable = self._unstoppable, self._unstoppable or always
            try:
                if not self._unstoppable:
                    self._gate.check()
                try:
                    yield
                except InstrumentError:
                    self._failed = True
                    raise
            finally:
                self._unstoppable = outer

    @contextmanager
    def _operation(self) -> Iterator[None]:
        with self._gate.operation():
            if not self._opened:
                raise NotConnected(self._name, "the projector is not open", "open it first")
            self._failed = False
            with self._line:
                if not self._reached:
                    self._join()
            try:
                yield
            except (Refused, Unsupported, ConfigurationError):
                # What the driver itself refuses has not reached the box.
                if self._failed:
                    self._secure()
                raise
            except BaseException:
                self._secure()
                raise

    def _dark(self) -> None:
        with self._talking():
            self._source.dark()

    def _join(self) -> None:
        """Connect to a box of which nothing is known; it forgets what a former one had loaded."""
        self._forget(ProjectorCondition.DARK)
        self._failed = False
        try:
            self._reach()
        except BaseException:
            if self._reached:
                with suppress(InstrumentError):
                    self._light_off()
            self._release()
            raise

    def _secure(self) -> None:
        """Turn the light off after an error, if the box can be reached at all; it stays off until `set_led`."""
        with self._line:
            self._light, self._darkened = None, bool(self.capabilities().leds)
            self._next = 0
            self._now(ProjectorCondition.DARK, None)
            reached = self._reached
            # Also where the box seems out of reach: its light may still be on, and a way back be found.
            with suppress(InstrumentError):
                self._light_off()
            if not reached:
                self._release()

    def _forget(self, condition: ProjectorCondition) -> None:
        self._sequence, self._next, self._light = None, 0, None
        self._now(condition, None)

    def _now(self, condition: ProjectorCondition, index: int | None) -> None:
        self._condition, self._shown = condition, index

    def _run(self, *, repeat: bool) -> None:
        with self._operation():
            self._ordered()
            self._refuse_dark()
            self._source.run(repeat=repeat)
            self._next = 0
            self._now(ProjectorCondition.RUNNING, None)
            self._check_health()

    def _ordered(self) -> PatternSequence:
        if self._sequence is None:
            raise Refused(self._name, "there is no order", "set one with `order`, after loading")
        return self._sequence

    def _refuse_dark(self) -> None:
        if self._condition is ProjectorCondition.PARKED:
            raise Refused(self._name, "the mirrors are parked", "unpark them first")
        if self._darkened:
            raise Refused(self._name, "the light was turned off after an error", "set the LED again")

    def _refuse_while_running(self) -> None:
        if self._condition is ProjectorCondition.RUNNING and self._runs():
            raise Refused(self._name, "a sequence is running", "wait for its end, or stop it")

    def _runs(self) -> bool:
        with self._talking():
            return self._read_status().condition is ProjectorCondition.RUNNING
