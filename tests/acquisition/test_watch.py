"""Instruments that go away and come back."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.protocols import DeviceFault, NotConnected
from irpmd_rig.acquisition import watch as watching
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.hands import Hands, Zeros
from irpmd_rig.acquisition.rig import DeviceCondition, DeviceState
from irpmd_rig.acquisition.watch import Watch


class RigFake:
    """Instruments whose states the test sets."""

    def __init__(self) -> None:
        self.stages: dict[str, Any] = {}
        self.operator = None
        self.devices = {
            "camera": DeviceState("camera", "none", DeviceCondition.READY),
            "stage1": DeviceState("stage", "none", DeviceCondition.READY),
        }
        self.file = SimpleNamespace(devices={}, trigger="hardware")
        self.reopened: list[str] = []
        self.refreshed = 0
        self.comes_back = False
        self.not_opened: set[str] = set()

    @property
    def camera(self) -> Any:
        raise NotConnected("camera", "not here", "none")

    projector = camera

    def now(self, name: str, condition: DeviceCondition) -> None:
        self.devices = {**self.devices, name: DeviceState("camera", "none", condition, "it went away", "plug it in")}

    def instrument(self, name: str) -> None:
        if name in self.not_opened:
            raise DeviceFault(name, "it failed", "look")

    def reopen(self, name: str) -> DeviceState:
        self.reopened.append(name)
        if self.comes_back:
            self.now(name, DeviceCondition.READY)
        return self.devices[name]

    def refresh(self) -> None:
        self.refreshed += 1


class Clock:
    """The clock that the watch looks at."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def time(self) -> float:
        return self.now_s


@pytest.fixture
def rig() -> RigFake:
    return RigFake()


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(watching, "time", clock)
    return clock


@pytest.fixture
def lost() -> list[str]:
    return []


@pytest.fixture
def events() -> EventLog:
    return EventLog()


@pytest.fixture
def hands() -> Hands:
    return Hands()


@pytest.fixture
def zeros() -> Zeros:
    return Zeros()


@pytest.fixture
def watch(rig: RigFake, lost: list[str], events: EventLog, hands: Hands, zeros: Zeros) -> Watch:
    safety: Any = SimpleNamespace(concerns={}, make_safe=dict)
    return Watch(rig, safety, hands, zeros, events, lost=lost.append)  # type: ignore[arg-type]


def test_everything_is_asked_from_time_to_time(watch: Watch, rig: RigFake, clock: Clock) -> None:
    for _ in range(10):
        watch._care()
        clock.now_s += 0.5
    assert rig.refreshed == 3
    assert rig.reopened == []


def test_what_is_gone_is_opened_again_with_growing_pauses(watch: Watch, rig: RigFake, clock: Clock) -> None:
    rig.now("camera", DeviceCondition.LOST)
    tried_s = []
    for _ in range(600):
        before = len(rig.reopened)
        watch._care()
        if len(rig.reopened) > before:
            tried_s.append(clock.now_s - 1000.0)
        clock.now_s += 0.5
    assert tried_s[:6] == [0.0, 1.0, 3.0, 7.0, 15.0, 25.0]
    pauses = {later - earlier for earlier, later in pairwise(tried_s[5:])}
    assert pauses == {10.0}
    assert rig.refreshed == 0


def test_what_came_back_has_another_zero_and_is_asked_again(
    watch: Watch, rig: RigFake, clock: Clock, zeros: Zeros
) -> None:
    rig.now("stage1", DeviceCondition.MISSING)
    watch._care()
    rig.comes_back = True
    clock.now_s += 1.0
    watch._care()
    assert rig.reopened == ["stage1", "stage1"]
    assert zeros.now() == {"stage1": 1}
    rig.now("stage1", DeviceCondition.LOST)
    watch._care()
    # A new loss begins with a short pause again.
    assert len(rig.reopened) == 3


def test_a_fault_is_asked_about_unless_opening_failed_by_it(watch: Watch, rig: RigFake, clock: Clock) -> None:
    rig.now("camera", DeviceCondition.FAULT)
    clock.now_s += 5.0
    watch._care()
    assert (rig.reopened, rig.refreshed) == ([], 1)
    rig.not_opened.add("camera")
    watch._care()
    assert rig.reopened == ["camera"]


def test_a_loss_is_announced_and_told_only_while_no_run_has_the_instruments(
    watch: Watch, rig: RigFake, lost: list[str], events: EventLog, hands: Hands
) -> None:
    reader = events.subscribe()
    rig.now("camera", DeviceCondition.LOST)
    watch.look()
    watch.look()
    assert lost == ["camera"]
    (event,) = reader.take() or []
    assert (event.kind, event.data["device"], event.data["state"]) == ("rig", "camera", "lost")
    assert watch.seen.devices["camera"].detail == "it went away"
    with hands.of_run("r1"):
        rig.now("stage1", DeviceCondition.FAULT)
        watch.look()
    assert lost == ["camera"]
