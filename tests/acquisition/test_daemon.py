"""The daemon on a small simulated rig: queue, lease, actions, prompts, commands by hand."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from daemon_world import OWNER, at_rest, began, carried_out, ended, stations

from drivers.protocols import CameraSettings, Led, LimitReached, Refused
from irpmd_rig.acquisition.book import ActionRefused, BadKey, KeyReused
from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import AlreadyRunning, RigDaemon
from irpmd_rig.acquisition.hands import RigBusy
from irpmd_rig.acquisition.intake import NoSuchRecipe, RecipeText, named_recipe
from irpmd_rig.acquisition.interlocks import NotReady
from irpmd_rig.acquisition.lease import LeaseHeld, LeaseNeeded
from irpmd_rig.acquisition.queue import STARTED
from irpmd_rig.acquisition.safety import StopLatched
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.store.errors import DiskFull, RunInUse, RunNotFound
from irpmd_rig.store.states import Reason, RunState
from tests.small_world import rig_file, until
from tests.small_world import world as served

ASKS = "\n  - {do: prompt, text: Turn the sample round.}\n  - {do: capture, label: turned}\n"
LONG = "\n  - {do: wait, time_s: 60}\n  - {do: capture, label: late}\n"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    with served(tmp_path_factory.mktemp("world")) as world:
        yield world


@pytest.fixture(scope="module")
def started(world: WorldControl, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RigDaemon]:
    with RigDaemon(rig_file(world.folder, tmp_path_factory.mktemp("data"))) as daemon:
        status = daemon.rig_status()
        assert not status.can_start
        assert status.reasons == (f"the queue is held: {STARTED} (resume it)",)
        yield daemon


@pytest.fixture
def daemon(started: RigDaemon, world: WorldControl) -> Iterator[RigDaemon]:
    """A daemon without runs, whose queue is held."""
    yield started
    lease = started.take_lease(OWNER, 60, override=True).id
    started.queue_action("hold")
    for status in started.runs():
        if status.state is not None and not status.state.final:
            started.act(status.id, "abort", lease)
        started.delete(status.id)
    started.release_lease(lease)
    at_rest(world)


@pytest.fixture
def lease(daemon: RigDaemon) -> str:
    return daemon.take_lease(OWNER, 60).id


def test_a_run_succeeds_with_every_frame_on_disk_and_the_rig_at_rest(daemon: RigDaemon, world: WorldControl) -> None:
    status = carried_out(daemon, stations(0, 10, pattern="fringes"))
    assert (status.state, status.reason, status.frames) == (RunState.SUCCEEDED, None, 12)
    at_rest(world)
    folder = daemon.store.run(status.id)
    places = [(entry.station, entry.set, entry.step, round(entry.stage1_mm or 0.0, 1)) for entry in folder.manifest()]
    assert places == [(k, s, t, 10.0 * k) for k in (0, 1) for s in (0, 1) for t in (0, 1, 2)]
    assert all(entry.stage1_measured and entry.exposure_us == 2000.0 for entry in folder.manifest())
    assert [state.state for state in folder.states()] == [
        "queued", "preparing", "running", "waiting_for_operator", "running", "reconstructing", "succeeded"
    ]  # fmt: skip
    record = folder.record()
    assert record.optics is not None
    assert record.optics.size_px == (96, 96)
    assert record.rig["stage1"]["driver"] == "serial"
    # A success lets the queue go on by itself.
    assert daemon.queue_status().held is False


def test_all_kinds_of_shots_are_told_apart(daemon: RigDaemon) -> None:
    more = "".join(
        f"\n  - {{do: show, pattern: {pattern}}}\n  - {{do: capture, label: {pattern}}}"
        for pattern in ("black", "plain")
    )
    status = carried_out(daemon, stations(0, more=more))
    folder = daemon.store.run(status.id)
    shots = {entry.role: (entry.label, entry.led, entry.intensity) for entry in folder.manifest()}
    assert shots == {
        "white": ("mirror", "infrared", 0.6),
        "black": ("black", "infrared", 0.6),
        "plain": ("plain", None, 0.0),
    }
    means = {entry.role: float(folder.read_frame(entry).mean()) for entry in folder.manifest()}
    assert means["white"] > 2 * means["black"]


def test_the_next_run_starts_by_itself_after_a_success(daemon: RigDaemon) -> None:
    first, _ = daemon.submit(stations(0))
    second, _ = daemon.submit(stations(5))
    assert daemon.queue_status().waiting == (first.id, second.id)
    assert (daemon.run(first.id).place, daemon.run(second.id).place) == (0, 1)
    daemon.queue_action("resume")
    assert ended(daemon, second.id).state is RunState.SUCCEEDED
    assert daemon.run(first.id).state is RunState.SUCCEEDED


def test_a_run_that_needs_a_person_does_not_start_by_itself(daemon: RigDaemon) -> None:
    first, _ = daemon.submit(stations(0))
    second, _ = daemon.submit(stations(5, more=ASKS))
    daemon.queue_action("resume")
    ended(daemon, first.id)
    until(lambda: daemon.queue_status().held)
    assert second.id in daemon.queue_status().why
    assert "needs an operator" in daemon.queue_status().why
    assert daemon.run(second.id).state is RunState.QUEUED


def test_a_person_answers_and_may_look_meanwhile(daemon: RigDaemon, world: WorldControl) -> None:
    run_id = began(daemon, stations(0, more=ASKS))
    until(lambda: daemon.run(run_id).prompt is not None)
    prompt = daemon.run(run_id).prompt
    assert prompt is not None
    assert prompt.text == "Turn the sample round."
    until(lambda: daemon.run(run_id).state is RunState.WAITING_FOR_OPERATOR)
    at_rest(world)
    lease = daemon.take_lease(OWNER, 60).id
    until(lambda: daemon.hand.camera_frame().image.shape == (96, 96))
    with pytest.raises(RigBusy, match=run_id):
        daemon.hand.stage_move("stage1", 1.0)
    with pytest.raises(ActionRefused, match="something else by now"):
        daemon.act(run_id, "answer", lease, prompt=prompt.id + 1)
    daemon.act(run_id, "answer", lease, prompt=prompt.id)
    assert ended(daemon, run_id).state is RunState.SUCCEEDED
    assert daemon.run(run_id).frames == 2
    with pytest.raises(ActionRefused, match="nothing to answer"):
        daemon.act(run_id, "answer", lease)


def test_an_object_that_the_world_lacks_is_refused_before_anything_moves(daemon: RigDaemon) -> None:
    validation = daemon.validate(RecipeText("kind: measure\nname: x\nobject: mirror_stepp\npositions_mm: [0, 40]\n"))
    (problem,) = validation.problems
    assert "mirror_stepp" in problem.what
    assert problem.line == 3


def test_a_person_may_answer_with_abort(daemon: RigDaemon) -> None:
    run_id = began(daemon, stations(0, more=ASKS))
    until(lambda: daemon.run(run_id).prompt is not None)
    daemon.act(run_id, "answer", daemon.take_lease(OWNER, 60).id, answer="abort")
    status = ended(daemon, run_id)
    assert (status.state, status.reason) == (RunState.ABORTED, Reason.ABORTED_BY_USER)


def test_pause_holds_before_the_next_station_and_resume_goes_on(daemon: RigDaemon, world: WorldControl) -> None:
    run_id = began(daemon, stations(*range(0, 60, 2)))
    lease = daemon.take_lease(OWNER, 60).id
    daemon.act(run_id, "pause", lease)
    until(lambda: daemon.run(run_id).state is RunState.PAUSED)
    at_rest(world)
    done = daemon.run(run_id).frames
    assert done is not None
    assert done < 30
    assert daemon.run(run_id).asked is None
    with pytest.raises(RigBusy):
        daemon.hand.stage_home("stage1")
    time.sleep(0.1)
    assert daemon.run(run_id).frames == done
    daemon.act(run_id, "resume", lease)
    assert ended(daemon, run_id).state is RunState.SUCCEEDED
    assert daemon.run(run_id).frames == 30


@pytest.mark.parametrize("more", ["", LONG], ids=["between frames", "while it waits"])
def test_abort_ends_the_run_at_once_and_retry_goes_on(daemon: RigDaemon, world: WorldControl, more: str) -> None:
    run_id = began(daemon, stations(*range(0, 60, 2), more=more))
    until(lambda: (daemon.run(run_id).frames or 0) >= (30 if more else 3))
    lease = daemon.take_lease(OWNER, 60).id
    began_s = time.monotonic()
    status = daemon.act(run_id, "abort", lease)
    # Long before what it waits for.
    assert time.monotonic() - began_s < 30.0
    assert (status.state, status.reason) == (RunState.ABORTED, Reason.ABORTED_BY_USER)
    assert OWNER in status.detail
    at_rest(world)
    assert daemon.queue_status().held
    if more:
        return
    kept = {entry.path for entry in daemon.store.run(run_id).manifest()}
    daemon.act(run_id, "retry", lease)
    daemon.release_lease(lease)
    daemon.queue_action("resume")
    status = ended(daemon, run_id)
    assert (status.state, status.attempt, status.frames) == (RunState.SUCCEEDED, 2, 30)
    # No axis got another zero: what was complete is kept, and nothing of one station is from two attempts.
    manifest = daemon.store.run(run_id).manifest()
    assert kept == {entry.path for entry in manifest if entry.attempt == 1}


def test_retry_begins_again_when_an_axis_was_homed_since(daemon: RigDaemon) -> None:
    run_id = began(daemon, stations(*range(0, 60, 2)))
    until(lambda: (daemon.run(run_id).frames or 0) >= 3)
    lease = daemon.take_lease(OWNER, 60).id
    daemon.act(run_id, "abort", lease)
    daemon.hand.stage_home("stage1")
    daemon.act(run_id, "retry", lease)
    daemon.release_lease(lease)
    daemon.queue_action("resume")
    assert ended(daemon, run_id).state is RunState.SUCCEEDED
    manifest = daemon.store.run(run_id).manifest()
    assert {entry.attempt for entry in manifest} == {2}
    assert len(manifest) == 30


def test_a_run_that_waits_is_aborted_without_the_rig(daemon: RigDaemon, lease: str) -> None:
    status, _ = daemon.submit(stations(0))
    assert daemon.act(status.id, "abort", lease).state is RunState.ABORTED
    assert daemon.queue_status().waiting == ()
    for action in ("abort", "pause", "resume", "answer"):
        with pytest.raises(ActionRefused, match="aborted"):
            daemon.act(status.id, action, lease)
    assert daemon.act(status.id, "retry", lease).attempt == 2
    with pytest.raises(ActionRefused, match="waits in the queue"):
        daemon.act(status.id, "pause", lease)


def test_a_lease_makes_queued_runs_wait_and_its_end_lets_them_start(daemon: RigDaemon) -> None:
    daemon.take_lease(OWNER, 4.0)
    status, _ = daemon.submit(stations(0))
    daemon.queue_action("resume")
    assert any(f"controlled by hand by {OWNER}" in reason for reason in daemon.rig_status().reasons)
    time.sleep(0.4)
    assert daemon.run(status.id).state is RunState.QUEUED
    assert ended(daemon, status.id).state is RunState.SUCCEEDED


def test_actions_need_the_lease_and_name_its_holder(daemon: RigDaemon) -> None:
    status, _ = daemon.submit(stations(0))
    with pytest.raises(LeaseNeeded):
        daemon.act(status.id, "abort", None)
    daemon.take_lease("Bea", 60)
    with pytest.raises(LeaseHeld, match="Bea"):
        daemon.act(status.id, "abort", "wrong")
    with pytest.raises(LeaseHeld, match="Bea"):
        daemon.take_lease(OWNER, 60)
    assert daemon.run(status.id).state is RunState.QUEUED


def test_an_idempotency_key_gives_the_same_run(daemon: RigDaemon) -> None:
    first, new = daemon.submit(stations(0), "key 1")
    again, newer = daemon.submit(stations(0), "key 1")
    assert (new, newer) == (True, False)
    assert first.id == again.id
    assert len(daemon.runs()) == 1
    with pytest.raises(KeyReused):
        daemon.submit(stations(1), "key 1")
    for key in ("", "a\nb", "x" * 201):
        with pytest.raises(BadKey):
            daemon.submit(stations(0), key)


def test_of_many_requests_with_one_key_one_makes_a_run(daemon: RigDaemon) -> None:
    ids = []
    threads = [threading.Thread(target=lambda: ids.append(daemon.submit(stations(0), "once")[0].id)) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(ids) == 6
    assert len(set(ids)) == 1


def test_a_recipe_that_cannot_run_is_refused_whole_with_its_lines(daemon: RigDaemon) -> None:
    wrong = stations(0, 9000)
    validation = daemon.validate(wrong)
    assert not validation.ok
    with pytest.raises(DocumentError) as raised:
        daemon.submit(wrong)
    assert raised.value.problems == validation.problems
    (problem,) = validation.problems
    assert "at most 1000" in problem.what
    assert problem.line == 13
    (problem,) = daemon.validate(stations(0, 230)).problems
    assert "outside the limits of stage1" in problem.what
    assert daemon.runs() == ()
    assert daemon.validate(RecipeText("kind: measur\nname: x")).problems


def test_validation_tells_what_a_recipe_would_take_and_moves_nothing(daemon: RigDaemon, world: WorldControl) -> None:
    before = world.call("state")["stages"]
    validation = daemon.validate(named_recipe("paper-measure"))
    assert validation.ok
    assert validation.estimate is not None
    assert validation.estimate.frames == 24
    assert len(validation.stations) == 2
    assert any("calibrate-geometry" in warning for warning in validation.warnings)
    assert world.call("state")["stages"] == before
    with pytest.raises(NoSuchRecipe, match="paper-measure"):
        named_recipe("../rigs/sim")


def test_a_measurement_without_calibration_fails_before_anything_moves(daemon: RigDaemon, world: WorldControl) -> None:
    before = world.call("state")["stages"]
    status = carried_out(daemon, named_recipe("paper-measure"))
    assert (status.state, status.reason) == (RunState.FAILED, Reason.REFUSED)
    assert "calibrate-geometry" in status.detail
    assert world.call("state")["stages"] == before
    assert status.id in daemon.queue_status().why


def test_stop_is_latched_and_fails_the_run(daemon: RigDaemon, world: WorldControl) -> None:
    run_id = began(daemon, stations(*range(0, 220, 10)))
    until(lambda: (daemon.run(run_id).frames or 0) >= 1)
    began_s = time.monotonic()
    reports = daemon.stop()
    assert time.monotonic() - began_s < 30.0
    assert set(reports) == {"camera", "projector", "stage1", "stage2"}
    assert all(report.stopped and report.error is None for report in reports.values())
    at_rest(world)
    status = daemon.run(run_id)
    assert (status.state, status.reason) == (RunState.FAILED, Reason.STOPPED)
    assert daemon.rig_status().stop_latched
    with pytest.raises(NotReady, match="clear the stop"):
        daemon.queue_action("resume")
    with pytest.raises(StopLatched):
        daemon.hand.projector_led(Led.INFRARED, 0.1)
    daemon.clear_stop()
    lease = daemon.take_lease(OWNER, 60).id
    daemon.act(run_id, "retry", lease)
    daemon.release_lease(lease)
    daemon.queue_action("resume")
    assert ended(daemon, run_id).state is RunState.SUCCEEDED


def test_commands_by_hand(daemon: RigDaemon, world: WorldControl, lease: str) -> None:
    hand = daemon.hand
    position = hand.stage_move("stage1", 25.0)
    assert position.measured
    assert position.position_mm == pytest.approx(25.0, abs=0.02)
    axis = daemon.rig_status().axes["stage1"]
    assert axis.position == position
    with pytest.raises(LimitReached):
        hand.stage_move("stage1", 9000.0)
    with pytest.raises(Refused, match="nobody confirms"):
        hand.stage_zero("stage1", 0.0, " ")
    hand.stage_home("stage1")
    world.call("place", subject="mirror", pose=0)
    hand.projector_led(Led.INFRARED, 0.3)
    hand.projector_show("white")
    assert world.call("state")["light"]
    assert world.call("state")["intensity"] == pytest.approx(0.3, abs=0.01)
    in_force = hand.camera_settings(CameraSettings(exposure_us=3000.0))
    assert in_force.exposure_us == pytest.approx(3000.0)
    bright = hand.camera_frame()
    hand.projector_show("fringes", count=8.0, step=1, steps=3)
    striped = hand.camera_frame()
    hand.projector_show("black")
    dark = hand.camera_frame()
    assert bright.image.mean() > striped.image.mean() > dark.image.mean()
    assert np.ptp(striped.image) > 20
    # Whoever gives the rig back leaves it dark.
    daemon.release_lease(lease)
    at_rest(world)


def test_an_expired_lease_leaves_the_rig_dark(daemon: RigDaemon, world: WorldControl) -> None:
    # Long enough for two commands, however busy the machine.
    daemon.take_lease(OWNER, 3.0)
    daemon.hand.projector_led(Led.INFRARED, 0.3)
    daemon.hand.projector_show("white")
    assert world.call("state")["light"]
    until(lambda: not world.call("state")["light"])
    until(lambda: world.call("state")["intensity"] == 0.0)


def test_events_tell_the_whole_run(daemon: RigDaemon) -> None:
    with daemon.events.subscribe() as everything:
        status = carried_out(daemon, stations(0))
        seen = everything.take()
    assert seen is not None
    states = [event.data["state"] for event in seen if event.kind == "state" and event.run_id == status.id]
    assert states == [
        "queued", "preparing", "running", "waiting_for_operator", "running", "reconstructing", "succeeded"
    ]  # fmt: skip
    assert any(event.kind == "progress" and event.data["frames_done"] == 1 for event in seen)
    assert any(event.kind == "queue" for event in seen)


def test_runs_are_deleted_only_when_they_have_ended(daemon: RigDaemon, lease: str) -> None:
    status, _ = daemon.submit(stations(0))
    with pytest.raises(RunInUse):
        daemon.delete(status.id)
    daemon.act(status.id, "abort", lease)
    daemon.delete(status.id)
    for call in (daemon.run, daemon.delete, lambda run_id: daemon.act(run_id, "abort", lease)):
        with pytest.raises(RunNotFound):
            call(status.id)


def test_one_daemon_a_store(daemon: RigDaemon, world: WorldControl) -> None:
    with pytest.raises(AlreadyRunning, match="another daemon"):
        RigDaemon(rig_file(world.folder, daemon.store.root))


def test_a_run_that_would_not_fit_is_refused(world: WorldControl, daemon: RigDaemon, tmp_path: Path) -> None:
    file = rig_file(world.folder, tmp_path)
    full = RigDaemon(type(file)(**{name: getattr(file, name) for name in file.__dataclass_fields__} | {
        "storage": file.storage.model_copy(update={"reserve_gb": 1e6})
    }))  # fmt: skip
    try:
        with pytest.raises(DiskFull):
            full.submit(stations(0))
        assert full.runs() == ()
        assert any("no room" in reason for reason in full.rig_status().reasons)
    finally:
        full.close()
    assert daemon.runs() == ()
