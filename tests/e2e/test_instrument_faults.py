"""Faults of instruments in the middle of a run: what the client sees, what is on disk, what the hardware does."""

from typing import Any, NamedTuple

import pytest

from irpmd_rig.client import ProblemError
from tests.campaigns.lab import Daemon, Lab, until
from tests.campaigns.on_disk import complaints, durable_frames, likeness, pictures, shifted, states
from tests.campaigns.recipes import stations

PLACES_MM = range(0, 36, 3)
LONG = stations(*PLACES_MM, pattern="white", wait_s=0.15)
SHORT = stations(0)
STAGE = {"stage": "stage1"}
# A run whose instrument is gone has failed within this.
BOUND_S = 60.0


class Fault(NamedTuple):
    """A fault and the reason for which a run fails of it; whether the instrument can be told to be safe meanwhile."""

    name: str
    reasons: set[str]
    arguments: dict[str, Any] = {}  # noqa: RUF012
    reached: bool = True
    bound_s: float = BOUND_S


MOTION = [
    Fault("stage_stall", {"motion_failed"}, STAGE),
    Fault("stage_overshoot", {"motion_failed"}, STAGE),
    Fault("stage_limit", {"limit"}, STAGE),
]
PROJECTOR = [
    Fault("projector_timeout", {"device_timeout"}),
    Fault("projector_led_fault", {"device_fault"}),
    Fault("projector_overheat", {"device_fault"}),
]


def failed(lab: Lab, daemon: Daemon, fault: Fault) -> str:
    """Let a fault come in the middle of a run; returns its id once everything about its end was looked at."""
    run_id = daemon.begin(LONG, frames=2)
    before = durable_frames(lab.root / run_id)
    lab.fault(fault.name, **fault.arguments)
    run = daemon.ended(run_id, fault.bound_s)
    assert (run.state, run.reason in fault.reasons) == ("failed", True), (run.reason, run.detail)
    assert run.detail
    if fault.reached:
        lab.at_rest()
    queue = daemon.client.queue()
    assert queue.held
    assert run_id in queue.why
    folder = lab.root / run_id
    assert (states(folder)[-1]["state"], states(folder)[-1]["reason"]) == ("failed", run.reason)
    assert before.items() <= durable_frames(folder).items()
    assert complaints(folder) == []
    return run_id


def completed(lab: Lab, daemon: Daemon, run_id: str) -> None:
    """Retry a run, which has to succeed."""
    before = durable_frames(lab.root / run_id)
    run = daemon.retry(run_id)
    assert (run.state, run.attempt, run.frames) == ("succeeded", 2, len(PLACES_MM)), (run.reason, run.detail)
    assert complaints(lab.root / run_id) == []
    assert before.items() <= durable_frames(lab.root / run_id).items()
    lab.at_rest()


def test_a_camera_that_is_unplugged_fails_the_run_and_comes_back_in_a_new_process(lab: Lab, daemon: Daemon) -> None:
    before = daemon.helpers()["camera"]
    run_id = failed(lab, daemon, Fault("camera_unplug", {"device_lost"}))
    rig = daemon.client.rig()
    assert rig.devices["camera"].state in ("lost", "missing")
    assert not rig.can_start
    assert any(reason.startswith("camera is") for reason in rig.reasons)
    assert {name: device.state for name, device in rig.devices.items() if name != "camera"} == {
        "projector": "ready",
        "stage1": "ready",
        "stage2": "ready",
    }
    with daemon.lease():
        assert daemon.client.stage_move("stage2", 1.0).measured
        with pytest.raises(ProblemError) as caught:
            daemon.client.camera_frame()
    assert caught.value.extras["device"] == "camera"
    lab.fault("camera_replug")
    daemon.ready()
    assert daemon.helpers()["camera"].pid != before.pid
    completed(lab, daemon, run_id)


def test_a_serial_line_that_is_unplugged_stops_all_axes_and_needs_a_zero_again(lab: Lab, daemon: Daemon) -> None:
    run_id = failed(lab, daemon, Fault("stage_unplug", {"device_lost"}, STAGE, reached=False))
    assert not lab.state()["stages"]["stage2"]["moving"]
    assert daemon.client.rig().devices["stage1"].state in ("lost", "missing")
    with daemon.lease(), pytest.raises(ProblemError) as caught:
        daemon.client.stage_move("stage1", 1.0)
    assert caught.value.extras["device"] == "stage1"
    lab.fault("stage_replug", **STAGE)
    daemon.ready()
    lab.at_rest()
    assert daemon.client.rig().axes["stage1"].position is None
    with daemon.lease(), pytest.raises(ProblemError, match="zero"):
        daemon.client.stage_move("stage1", 1.0)
    completed(lab, daemon, run_id)
    # Frames of two zeros are never mixed.
    assert {entry.attempt for entry in daemon.client.frames(run_id)} == {2}


@pytest.mark.parametrize("fault", [*MOTION, *PROJECTOR], ids=lambda fault: fault.name)
def test_a_motion_or_a_projector_that_fails_ends_the_run_in_the_dark(lab: Lab, daemon: Daemon, fault: Fault) -> None:
    run_id = failed(lab, daemon, fault)
    lab.mend()
    daemon.ready()
    completed(lab, daemon, run_id)


@pytest.fixture(scope="module")
def model(lab: Lab, running: Daemon) -> Any:
    """The pictures of a run to which nothing happened."""
    run = running.carry_out(stations(0, 8))
    assert run.state == "succeeded", run.detail
    found = pictures(lab.root / run.id)
    others = [likeness(found[a], found[b]) for a in found for b in found if a < b]
    assert max(others) < 0.98
    return found


@pytest.mark.parametrize(
    ("name", "trigger", "arguments"),
    [
        ("frame_dropped", "hardware", {}),
        ("frame_incomplete", "hardware", {}),
        ("trigger_missed", "hardware", {}),
        ("sync_missed", "hardware", {}),
        # In the world's seconds.
        ("frame_late", "software", {"seconds": 110.0}),
        ("frame_dropped", "software", {}),
    ],
)
def test_a_frame_that_fails_is_taken_again_and_no_index_shifts(
    lab: Lab, daemon: Daemon, model: Any, name: str, trigger: str, arguments: dict[str, Any]
) -> None:
    run_id = daemon.submit(stations(0, 8, trigger=trigger, retries=2))
    told = len(lab.log.read_text())
    lab.fault(name, **arguments)
    daemon.resume()
    run = daemon.ended(run_id)
    assert (run.state, run.frames) == ("succeeded", 12), (run.reason, run.detail)
    assert complaints(lab.root / run_id) == []
    assert shifted(lab.root / run_id, model) == []
    assert "a frame is" in lab.log.read_text()[told:]
    lab.at_rest()


def test_frames_that_never_come_end_the_run_after_a_bounded_number_of_attempts(lab: Lab, daemon: Daemon) -> None:
    # Two attempts, of five seconds each.
    failed(lab, daemon, Fault("frame_dropped", {"frames_lost"}, {"frames": 10_000}, bound_s=80.0))
    lab.fault("frame_dropped", frames=1)
    assert daemon.carry_out(SHORT).state == "succeeded"


def test_saturated_frames_end_the_run_and_none_of_them_is_kept(lab: Lab, daemon: Daemon) -> None:
    run = daemon.carry_out(stations(0, exposure_us=60_000.0))
    assert (run.state, run.reason, run.frames) == ("failed", "frame_quality", 0)
    assert "full scale" in run.detail
    assert complaints(lab.root / run.id) == []
    lab.at_rest()


def test_a_camera_process_that_is_killed_is_replaced(lab: Lab, daemon: Daemon) -> None:
    before = daemon.helpers()["camera"]
    run_id = daemon.begin(LONG, frames=2)
    before.kill()
    run = daemon.ended(run_id, BOUND_S)
    lab.at_rest(30.0)
    assert complaints(lab.root / run_id) == []
    until(lambda: "camera" in daemon.helpers(), 30.0, "another camera process")
    assert daemon.helpers()["camera"].pid != before.pid
    # Between two frames nothing is lost with it: the next operation has another one.
    if run.state != "succeeded":
        assert (run.state, run.reason) == ("failed", "device_lost"), run.detail
        completed(lab, daemon, run_id)
