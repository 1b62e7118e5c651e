"""Looks after the instruments: what they are doing, whether they are there, and brings back those that were lost."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.protocols import InstrumentError, StageCondition
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.hands import Hands, Zeros
from irpmd_rig.acquisition.interlocks import equipment_of
from irpmd_rig.acquisition.rig import DeviceCondition, DeviceState, Rig
from irpmd_rig.acquisition.safety import Safety
from irpmd_rig.acquisition.status import AxisStatus
from irpmd_rig.recipes.equipment import Equipment

LOOK_S = 0.5
ASK_S = 2.0
# From the first attempt to bring an instrument back to the next, doubled each time up to the last.
BACK_OFF_S = (1.0, 10.0)
_GONE = (DeviceCondition.LOST, DeviceCondition.MISSING)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Seen:
    """The instruments when they were last looked at.

    Attributes
    ----------
    devices, axes
        By name.
    equipment
        What the rig can do.
    time_s
        Seconds since 1970.
    """

    devices: dict[str, DeviceState]
    axes: dict[str, AxisStatus]
    equipment: Equipment
    time_s: float


class Watch:
    """A thread that looks at the instruments, and at whatever else is to be done from time to time.

    Stages are looked at while others use them; everything else only while nobody does.

    Parameters
    ----------
    rig, safety, hands, zeros
        The instruments.
    events
        Where changes are announced.
    lost
        Called when an instrument that was ready is not any more, while no run has it.

    Attributes
    ----------
    chores : list of callable
        Called each time.
    """

    def __init__(
        self,
        rig: Rig,
        safety: Safety,
        hands: Hands,
        zeros: Zeros,
        events: EventLog,
        *,
        lost: Callable[[str], None],
    ) -> None:
        self._rig = rig
        self._safety = safety
        self._hands = hands
        self._zeros = zeros
        self._events = events
        self._lost = lost
        self.chores: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._seen = Seen(rig.devices, {}, equipment_of(rig), time.time())
        self._again: dict[str, tuple[float, float]] = {}
        self._asked_s = 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="watch", daemon=True)

    @property
    def seen(self) -> Seen:
        """What was seen last; never waits for an instrument."""
        with self._lock:
            return self._seen

    def start(self) -> None:
        """Look once, then from time to time."""
        self._learn()
        self.look()
        self._thread.start()

    def close(self, limit_s: float) -> None:
        """End the thread."""
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join(limit_s)

    def look(self) -> None:
        """Look at the stages now, and take note of what is known of the others."""
        axes = {}
        for name, stage in self._rig.stages.items():
            told = stage.state()
            limits = None if told.condition is StageCondition.CLOSED else stage.limits()
            axes[name] = AxisStatus(told.condition, told.position, told.target_mm, limits)
        devices = self._rig.devices
        with self._lock:
            before = self._seen
            self._seen = replace(before, devices=devices, axes=axes, time_s=time.time())
        for name, state in devices.items():
            was = before.devices.get(name)
            if was is not None and was.state is not state.state:
                self._events.announce("rig", device=name, state=state.state, detail=state.detail, remedy=state.remedy)
                if was.state is DeviceCondition.READY and self._hands.run_id is None:
                    self._lost(name)

    def _learn(self) -> None:
        """Ask the instruments what they can do."""
        equipment = equipment_of(self._rig)
        with self._lock:
            self._seen = replace(self._seen, equipment=equipment)

    def _work(self) -> None:
        while not self._closing.wait(LOOK_S):
            try:
                with self._hands.of_watch() as free:
                    if free:
                        self._care()
                self.look()
                for chore in self.chores:
                    chore()
            # The thread must not end: nobody else brings instruments back.
            except Exception:
                _log.exception("the watch goes on after a fault of the program")

    def _care(self) -> None:
        """Bring back what is gone; else ask everything whether it is there."""
        gone = [name for name, state in self._rig.devices.items() if self._is_gone(name, state.state)]
        for name in set(self._again) - set(gone):
            del self._again[name]
        for name in gone:
            self._bring_back(name)
        now_s = time.monotonic()
        if now_s - self._asked_s >= ASK_S:
            self._asked_s = now_s
            if self._safety.concerns:
                self._safety.make_safe()
            if not gone:
                self._rig.refresh()

    def _is_gone(self, name: str, condition: DeviceCondition) -> bool:
        if condition is DeviceCondition.FAULT:
            # One that reports a fault is asked again; one whose opening failed by it has to be opened again.
            try:
                self._rig.instrument(name)
            except InstrumentError:
                return True
        return condition in _GONE

    def _bring_back(self, name: str) -> None:
        now_s = time.monotonic()
        due_s, pause_s = self._again.get(name, (now_s, BACK_OFF_S[0]))
        if now_s < due_s:
            return
        try:
            state = self._rig.reopen(name)
        except InstrumentError as error:
            _log.warning("%s", error)
            return
        if state.state is DeviceCondition.READY:
            _log.info("%s is back", name)
            self._zeros.given(name)
            self._safety.make_safe()
            self._learn()
            return
        # Counted from the end: opening may take long.
        self._again[name] = (time.monotonic() + pause_s, min(2.0 * pause_s, BACK_OFF_S[1]))
