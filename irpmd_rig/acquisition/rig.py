"""A rig: its instruments opened, each for itself, made safe and closed together."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, TypeVar, cast

from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    InstrumentError,
    NotConnected,
    Refused,
    TimedOut,
)
from drivers.protocols import Camera, Instrument, Projector, Stage
from drivers.registry import Kind, make
from drivers.values import Position, StageCondition, StopAnswer
from irpmd_rig.acquisition.conditions import DeviceCondition as DeviceCondition
from irpmd_rig.acquisition.errors import SimulationError
from irpmd_rig.acquisition.rig_file import Device, RigFile
from irpmd_rig.acquisition.simulated import SimulatedOperator, attach

if TYPE_CHECKING:
    from irpmd_rig.recipes.plan import Scene

# An operation that was stopped leaves the projector within this, and the LED can be turned off.
DARK_LIMIT_S = 5.0
DARK_RETRY_S = 0.02

_log = logging.getLogger(__name__)
Result = TypeVar("Result")


class Operator(Protocol):
    """Does what software cannot: a simulated rig has one, at a real one a person is asked."""

    name: str
    subjects: tuple[str, ...]
    board_poses: int

    def arrange(self, scene: Scene) -> None:
        """Place what a scene asks for."""

    def read_scale(self, stage: str) -> float:
        """Read a stage's position, in mm, off the scale beside it."""


@dataclass(frozen=True, slots=True)
class DeviceState:
    """An instrument as it was last seen.

    Attributes
    ----------
    detail, remedy
        What is wrong and what mends it; empty if nothing is. A wrong setting is told with file, line and column.
    error
        The driver's own error.
    """

    kind: Kind
    driver: str
    state: DeviceCondition
    detail: str = ""
    remedy: str = ""
    error: InstrumentError | None = None


_CONDITIONS: tuple[tuple[type[InstrumentError], DeviceCondition], ...] = (
    (ConfigurationError, DeviceCondition.MISCONFIGURED),
    (NotConnected, DeviceCondition.MISSING),
    (DeviceLost, DeviceCondition.LOST),
    (DeviceFault, DeviceCondition.FAULT),
    (TimedOut, DeviceCondition.FAULT),
)


class Rig:
    """The instruments of a rig file.

    Parameters
    ----------
    rig_file
        What `irpmd_rig.acquisition.rig_file.read_rig` returned.

    Examples
    --------
    >>> with Rig(read_rig("sim")) as rig:                  # doctest: +SKIP
    ...     rig.stages["stage1"].move_to(40.0)
    """

    def __init__(self, rig_file: RigFile) -> None:
        self._file = rig_file
        self._attached = rig_file
        self._operator: SimulatedOperator | None = None
        self._instruments: dict[str, Instrument] = {}
        self._is_open = False
        self._attaching = threading.Lock()
        self._lock = threading.Lock()
        self._states = {name: self._state(device) for name, device in rig_file.devices.items()}

    # --- what it is

    @property
    def file(self) -> RigFile:
        """The rig file; on an open simulated rig with what its world filled in."""
        return self._attached

    @property
    def simulated(self) -> bool:
        """Whether a simulated world stands in for the instruments."""
        return self._file.world is not None

    @property
    def operator(self) -> Operator | None:
        """Who places boards, mirrors and objects; None: a person has to be asked."""
        return self._operator

    @property
    def devices(self) -> dict[str, DeviceState]:
        """The instruments by name, as last seen."""
        with self._lock:
            return dict(self._states)

    @property
    def camera(self) -> Camera:
        """The camera; raises as `instrument`."""
        return cast(Camera, self.instrument("camera"))

    @property
    def projector(self) -> Projector:
        """The projector; raises as `instrument`."""
        return cast(Projector, self.instrument("projector"))

    @property
    def stages(self) -> dict[str, Stage]:
        """The stages that were opened, by name."""
        with self._lock:
            return {
                name: cast(Stage, it) for name, it in self._instruments.items() if self._states[name].kind == "stage"
            }

    def stage(self, name: str) -> Stage:
        """One stage; raises as `instrument`, also where there is no stage of that name."""
        if name in self._states and self._states[name].kind != "stage":
            raise NotConnected(name, "this is no stage", "name stage1 or stage2")
        return cast(Stage, self.instrument(name))

    def instrument(self, name: str) -> Instrument:
        """Return the driver of an instrument that was opened.

        Raises
        ------
        InstrumentError
            It is not in the rig file, was not opened, or why it could not be.
        """
        with self._lock:
            found, state = self._instruments.get(name), self._states.get(name)
        if found is not None:
            return found
        if state is None:
            known = ", ".join(self._states)
            raise NotConnected(name, "the rig has no such instrument", f"it has {known}")
        if state.error is None:
            raise NotConnected(name, "the rig is not open", "open it first")
        raise type(state.error)(state.error.device, state.detail, state.remedy)

    # --- open and close

    def open(self, *, find_zeros: bool = True) -> None:
        """Open every instrument, each for itself: what could not be opened is in `devices`.

        A simulated rig finds or starts its world first, and homes its axes unless `find_zeros` is False.

        Raises
        ------
        SimulationError
            The world is not there.
        """
        self._find_world()
        self._is_open = True
        self._each(self._open_one, self._file.devices)
        if self.simulated and find_zeros:
            self._each(self._zeroed_or_noted, self.stages)

    def close(self) -> None:
        """Close every instrument, and end a world that was started for this rig; never raises, may be repeated."""
        self._is_open = False
        with self._lock:
            instruments, self._instruments = self._instruments, {}
            self._states = {name: self._state(device) for name, device in self._file.devices.items()}
        self._each(lambda name: instruments[name].close(), instruments)
        operator, self._operator = self._operator, None
        self._attached = self._file
        if operator is not None:
            operator.close()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def reopen(self, name: str) -> DeviceState:
        """Close one instrument and open it again; an axis then has no zero.

        A simulated world that has ended is looked for, or started, again.

        Raises
        ------
        NotConnected
            The rig has no such instrument, or is not open.
        """
        if name not in self._file.devices:
            raise NotConnected(name, "the rig has no such instrument", f"it has {', '.join(self._file.devices)}")
        if not self._is_open:
            raise NotConnected(name, "the rig is not open", "open it first")
        with self._lock:
            old = self._instruments.pop(name, None)
        if old is not None:
            old.close()
        try:
            self._find_world()
        except SimulationError as error:
            self._set(name, DeviceCondition.MISSING, NotConnected(name, error.what, error.remedy))
        else:
            self._open_one(name)
        return self.devices[name]

    # --- state

    def note(self, error: InstrumentError) -> None:
        """Keep an instrument's error as its state, if it says that the instrument cannot be used now."""
        for kind, condition in _CONDITIONS:
            if isinstance(error, kind) and error.device in self._file.devices:
                self._set(error.device, condition, error)
                return

    def refresh(self) -> dict[str, DeviceState]:
        """Ask every instrument that was opened whether it is there; not for use while one is working."""
        operator = self._operator
        if operator is not None and operator.control.has_ended():
            # Whatever its instruments say of cables and plugs.
            for name in self._file.devices:
                gone = NotConnected(name, "the simulated world has ended", "wait: it is looked for, or started, again")
                self._set(name, DeviceCondition.MISSING, gone)
            return self.devices
        with self._lock:
            opened = dict(self._instruments)
        self._each(self._ask, opened)
        return self.devices

    def find_zero(self, name: str) -> Position:
        """Give one axis its zero: it homes, or the rig's operator reads the scale.

        Raises
        ------
        InstrumentError
            As `Stage.home`; Refused where the stage cannot home and a person has to say where it stands.
        SimulationError
            The simulated operator cannot read the scale.
        """
        stage = self.stage(name)
        if stage.capabilities().can_home:
            return stage.home()
        if self._operator is None:
            raise Refused(
                name, "this stage cannot home", "read its scale, then zero it at what you read, under your name"
            )
        return stage.zero(self._operator.read_scale(name), confirmed_by=self._operator.name)

    def find_zeros(self) -> dict[str, Position]:
        """Give every axis a zero that has none; raises as `find_zero`, when all have ended."""
        without = [name for name, stage in self.stages.items() if stage.state().position is None]
        return self._each(self.find_zero, without)

    # --- safety

    def make_safe(self) -> dict[str, StopAnswer | InstrumentError]:
        """Turn the LED off, make the projector dark, stop the stages and the camera, all at the same time.

        Returns
        -------
        dict
            For every instrument that was opened what its driver answered, or why it could not be told.
        """
        with self._lock:
            opened = dict(self._instruments)

        def safe(name: str) -> StopAnswer | InstrumentError:
            try:
                return _dark(cast(Projector, opened[name])) if name == "projector" else opened[name].stop()
            except InstrumentError as error:
                self.note(error)
                return error

        return self._each(safe, opened)

    # --- inside

    def _find_world(self) -> None:
        """Attach the world of a simulated rig, unless it is attached and answers."""
        if not self.simulated:
            return
        with self._attaching:
            operator = self._operator
            if operator is not None:
                if operator.answers():
                    return
                operator.close()
            self._attached, self._operator = attach(self._file)

    def _open_one(self, name: str) -> None:
        device = self._attached.devices[name]
        try:
            instrument = make(device.kind, device.driver, name, device.settings)
            instrument.open()
        except InstrumentError as error:
            _log.info("%s", error)
            self._set(name, DeviceCondition.MISSING, error)
            self.note(error)
            return
        with self._lock:
            self._instruments[name] = instrument
        self._set(name, DeviceCondition.READY)

    def _zeroed_or_noted(self, name: str) -> None:
        try:
            self.find_zero(name)
        except InstrumentError as error:
            _log.info("%s", error)
            self.note(error)
        except SimulationError as error:
            _log.info("%s", error)

    def _ask(self, name: str) -> None:
        instrument = self.instrument(name)
        try:
            if isinstance(instrument, Stage):
                if instrument.state().condition is StageCondition.LOST:
                    raise DeviceLost(name, "its line went away", "plug it in and switch it on")
            elif isinstance(instrument, Projector):
                instrument.status()
            elif isinstance(instrument, Camera):
                instrument.capabilities()
        except InstrumentError as error:
            self.note(error)
        else:
            self._set(name, DeviceCondition.READY)

    def _set(self, name: str, condition: DeviceCondition, error: InstrumentError | None = None) -> None:
        state = self._state(self._file.devices[name], condition, error)
        with self._lock:
            self._states[name] = state

    def _state(
        self, device: Device, condition: DeviceCondition = DeviceCondition.CLOSED, error: InstrumentError | None = None
    ) -> DeviceState:
        detail = "" if error is None else error.what
        if isinstance(error, ConfigurationError):
            found = self._file.problem(error)
            detail = f"{found.file}:{found.line}:{found.column}: {error.what}"
        return DeviceState(device.kind, device.driver, condition, detail, "" if error is None else error.remedy, error)

    @staticmethod
    def _each(call: Callable[[str], Result], names: Mapping[str, object] | list[str]) -> dict[str, Result]:
        """Call for all names at the same time; after all have ended, raise the first error."""
        if not names:
            return {}
        with ThreadPoolExecutor(len(names)) as pool:
            futures = {name: pool.submit(call, name) for name in names}
        return {name: future.result() for name, future in futures.items()}


def _dark(projector: Projector) -> StopAnswer:
    """Stop a projector and turn its LEDs off, also while another thread's operation is coming to its end."""
    answer = projector.stop()
    leds = projector.capabilities().leds
    end_s = time.monotonic() + DARK_LIMIT_S
    while leds:
        try:
            projector.set_led(leds[0], 0.0)
            break
        except Refused:
            if time.monotonic() > end_s:
                raise
            time.sleep(DARK_RETRY_S)
    return answer
