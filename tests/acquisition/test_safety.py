import threading
import time
from typing import Any

import pytest

from drivers.protocols import DeviceFault, StopAnswer
from irpmd_rig.acquisition.events import EventLog
from irpmd_rig.acquisition.rig import DeviceCondition, DeviceState
from irpmd_rig.acquisition.safety import Overdue, Safety, StopLatched, bounded


class Instruments:
    """A rig that answers what it is told to."""

    def __init__(self, answers: dict[str, Any]) -> None:
        self.answers = answers
        self.devices = {
            name: DeviceState("stage", "none", DeviceCondition.READY) for name in ("camera", "projector", "stage1")
        }
        self.hang = threading.Event()
        self.hang.set()

    def make_safe(self) -> dict[str, Any]:
        self.hang.wait(60)
        return self.answers


def safety(rig: Instruments, limit_s: float = 5.0) -> Safety:
    return Safety(rig, EventLog(), limit_s)  # type: ignore[arg-type]


def test_every_instrument_is_reported() -> None:
    rig = Instruments(
        {"projector": StopAnswer(stopped=True), "stage1": StopAnswer(stopped=False, ends_in_s=3.0)},
    )
    rig.devices["camera"] = DeviceState("camera", "none", DeviceCondition.MISSING, "not plugged in", "plug it in")
    made = safety(rig)
    reports = made.make_safe()
    assert reports["projector"].stopped
    assert (reports["stage1"].stopped, reports["stage1"].ends_in_s) == (False, 3.0)
    assert "missing not plugged in" in (reports["camera"].error or "")
    # Nobody can do anything about what is not there.
    assert made.concerns == {}


def test_what_could_not_be_made_safe_is_a_concern_until_it_is() -> None:
    rig = Instruments({"projector": DeviceFault("projector", "its LED does not go off", "pull the plug")})
    made = safety(rig)
    assert made.make_safe()["projector"].error == "its LED does not go off (pull the plug)"
    assert made.concerns == {"projector": "its LED does not go off (pull the plug)"}
    rig.answers = {"projector": StopAnswer(stopped=True)}
    made.make_safe()
    assert made.concerns == {}


def test_an_instrument_that_never_answers_holds_nobody_up() -> None:
    rig = Instruments({})
    rig.hang.clear()
    made = safety(rig, limit_s=0.05)
    began_s = time.monotonic()
    reports = made.make_safe()
    rig.hang.set()
    assert time.monotonic() - began_s < 30.0
    assert set(reports) == {"camera", "projector", "stage1"}
    assert all(not report.stopped and "did not answer" in (report.error or "") for report in reports.values())
    assert set(made.concerns) == set(reports)


def test_the_stop_is_latched_until_it_is_cleared() -> None:
    made = safety(Instruments({}))
    made.check()
    made.latch()
    assert made.latched
    with pytest.raises(StopLatched, match="clear the stop"):
        made.check()
    made.clear()
    made.check()


def test_bounded_passes_results_and_errors() -> None:
    assert bounded(lambda: 5, 1.0) == 5
    with pytest.raises(ValueError, match="inside"):
        bounded(lambda: int("inside"), 1.0)
    with pytest.raises(Overdue):
        bounded(lambda: time.sleep(0.2), 0.01)
