"""The client against the daemon itself, on a small simulated rig."""

import asyncio
import threading
from pathlib import Path

import pytest
import tifffile

from irpmd_rig.client import (
    AsyncClient,
    Client,
    ClientError,
    Event,
    NotInTime,
    ProblemError,
    RunFailed,
    ServiceUnreachable,
    TokenUnreadable,
)

TWO_PLACES = """kind: sequence
name: two places
exposure_us: 2000.0
steps:
  - {do: prompt, text: Place the mirror., subject: mirror}
  - {do: show, pattern: white}
  - {do: move, stage: stage1, position_mm: 0}
  - {do: capture, label: near}
  - {do: move, stage: stage1, position_mm: 10}
  - {do: capture, label: far}
"""
ASKS = TWO_PLACES + "  - {do: prompt, text: Turn the sample round.}\n  - {do: capture, label: turned}\n"
LONG = TWO_PLACES + "  - {do: wait, time_s: 60}\n  - {do: capture, label: late}\n"


def test_the_rig_is_told_with_every_reason_why_it_cannot_start(rig: Client) -> None:
    assert rig.health().status == "ok"
    told = rig.rig()
    assert told.simulated
    assert {name: device.kind for name, device in told.devices.items()} == {
        "camera": "camera", "projector": "projector", "stage1": "stage", "stage2": "stage"
    }  # fmt: skip
    assert told.axes["stage1"].position is not None
    assert told.axes["stage1"].position.measured
    assert not told.can_start
    assert any("queue is held" in reason for reason in told.reasons)
    assert "# HELP" in rig.metrics()


def test_a_recipe_is_carried_out_and_told_of_while_it_goes_on(rig: Client, tmp_path: Path) -> None:
    file = tmp_path / "two.yaml"
    file.write_text(TWO_PLACES, encoding="utf-8")
    told: list[Event] = []
    run = rig.carry_out(file, on_event=told.append, timeout_s=60)
    assert (run.state, run.kind, run.name, run.frames) == ("succeeded", "sequence", "two places", 2)
    states = [event.data["state"] for event in told if event.kind == "state"]
    assert states[0] == "preparing"
    assert states[-1] == "succeeded"
    assert [event.data["frames_done"] for event in told if event.kind == "progress"][-1] == 2
    assert {event.run_id for event in told} == {run.id}
    assert run.id in [one.id for one in rig.runs(limit=5)]
    assert rig.queue().active_run is None

    near, far = rig.frames(run.id)
    assert (near.label, far.label) == ("near", "far")
    assert far.stage1_mm == pytest.approx(10.0, abs=0.02)
    saved = rig.download(run.id, far.path, tmp_path)
    assert saved == tmp_path / Path(far.path).name
    assert tifffile.imread(saved).shape == (96, 96)
    assert rig.export(run.id, "hdf5", tmp_path / "run.h5").read_bytes().startswith(b"\x89HDF")

    rig.delete_run(run.id)
    with pytest.raises(ProblemError) as gone:
        rig.run(run.id)
    assert (gone.value.status, gone.value.kind) == (404, "no-such-run")


def test_a_file_that_does_not_arrive_leaves_nothing(rig: Client, tmp_path: Path) -> None:
    run = rig.submit(TWO_PLACES)
    for path in ("results/none.npy", "frames/../../token", "frames/none.tif"):
        with pytest.raises(ProblemError) as missing:
            rig.download(run.id, path, tmp_path)
        assert missing.value.status == 404
    with pytest.raises(ProblemError):
        rig.export(run.id, "ply", tmp_path / "points.ply")
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_recipe_is_told_line_by_line(rig: Client) -> None:
    wrong = TWO_PLACES.replace("exposure_us", "exposure").replace("position_mm: 10", "position_mm: 5000")
    checked = rig.validate(wrong)
    assert not checked.ok
    assert (checked.problems[0].line, checked.problems[0].column) == (3, 1)
    with pytest.raises(ProblemError, match="recipe:3:1: ") as refused:
        rig.submit(wrong)
    assert refused.value.kind == "recipe-refused"
    assert "exposure_us" in str(refused.value)
    right = rig.validate(TWO_PLACES)
    assert right.ok
    assert right.estimate is not None
    assert right.estimate.frames == 2
    assert "paper-measure" in [recipe.id for recipe in rig.recipes()]
    with pytest.raises(ProblemError, match="paper-measure"):
        rig.submit("no-such-recipe")


def test_one_key_makes_one_run(rig: Client) -> None:
    first = rig.submit(TWO_PLACES, idempotency_key="test-one-key")
    assert rig.submit(TWO_PLACES, idempotency_key="test-one-key").id == first.id
    with pytest.raises(ProblemError) as other:
        rig.submit(LONG, idempotency_key="test-one-key")
    assert other.value.kind == "key-reused"


def test_the_lease_goes_with_every_request_and_keeps_others_out(rig: Client, place: Path) -> None:
    with pytest.raises(ProblemError) as needed:
        rig.stage_move("stage1", 5.0)
    assert needed.value.kind == "lease-needed"
    with Client(rig.url, place / "data" / "token") as other, other.lease("Grace", 60.0) as lease:
        assert other.lease_id == lease.id
        with pytest.raises(ProblemError) as held:
            rig.take_lease("Ada")
        assert held.value.status == 409
        assert held.value.extras["holder"]["owner"] == "Grace"
        taken = rig.take_lease("Ada", override=True)
        assert taken.overridden == "Grace"
        with pytest.raises(ProblemError):
            other.renew_lease()
        other.lease_id = taken.id
    assert other.lease_id is None


def test_instruments_are_commanded_by_hand(rig: Client) -> None:
    with rig.lease("Ada", 60.0):
        assert rig.stage_move("stage1", 7.5).position_mm == pytest.approx(7.5, abs=0.02)
        assert rig.stage_home("stage1").measured
        rig.projector_led("infrared", 0.3)
        rig.projector_show("fringes", count=8.0, step=1, steps=4)
        assert rig.camera_settings(exposure_us=3000.0).exposure_us == pytest.approx(3000.0, rel=0.01)
        frame = rig.camera_frame()
        assert frame.shape == (96, 96)
        assert rig.camera_picture("png").startswith(b"\x89PNG")
        assert rig.stage_stop("stage1").outcome == "stopped"
        with pytest.raises(ProblemError, match="limit"):
            rig.stage_move("stage1", 5000.0)


def test_a_run_is_paused_answered_and_aborted(rig: Client) -> None:
    run = rig.submit(ASKS)
    rig.resume_queue()
    prompts = (event for event in rig.events(run.id) if event.kind == "prompt")
    if rig.run(run.id).prompt is None:
        assert next(prompts).data["text"] == "Turn the sample round."
    assert rig.run(run.id).state == "waiting_for_operator"
    with rig.lease("Ada"):
        rig.act(run.id, "answer")
    assert rig.wait(run.id, timeout_s=30).state == "succeeded"
    long = rig.submit(LONG)
    rig.resume_queue()
    with pytest.raises(NotInTime):
        rig.wait(long.id, timeout_s=0.0)
    with rig.lease("Ada"):
        rig.act(long.id, "abort")
    ended = rig.run(long.id)
    assert (ended.state, ended.reason) == ("aborted", "aborted_by_user")


def test_a_run_that_fails_is_an_error_of_who_waits_for_it(rig: Client) -> None:
    stopping = threading.Thread(target=rig.stop)

    def stop_soon(event: Event) -> None:
        # A run is running again after every answer of the operator.
        if event.kind == "state" and event.data["state"] == "running" and stopping.ident is None:
            stopping.start()

    with pytest.raises(RunFailed, match="stopped") as failed:
        rig.carry_out(LONG, on_event=stop_soon, timeout_s=60)
    stopping.join()
    assert failed.value.run.reason == "stopped"
    assert rig.rig().stop_latched
    with pytest.raises(ProblemError) as not_ready:
        rig.resume_queue()
    assert not_ready.value.kind == "not-ready"
    assert any("stop" in reason for reason in not_ready.value.extras["reasons"])


def test_events_go_on_after_the_last_one_that_was_seen(rig: Client) -> None:
    run = rig.carry_out(TWO_PLACES, timeout_s=60)
    first = next(event for event in rig.events(after=0) if event.run_id == run.id)
    three = list(rig.events(after=first.id, limit=3))
    assert [event.id for event in three] == [first.id + 1, first.id + 2, first.id + 3]
    of_run = list(rig.events(run.id, after=first.id, limit=3))
    assert all(event.run_id == run.id for event in of_run)
    assert of_run == sorted(of_run, key=lambda event: event.id)


def test_everything_goes_without_blocking_too(rig: Client, place: Path, tmp_path: Path) -> None:
    async def script() -> None:
        async with AsyncClient(rig.url, place / "data" / "token") as lab:
            told: list[Event] = []
            run = await lab.carry_out(TWO_PLACES, on_event=told.append, timeout_s=60)
            assert told[0].data == {**told[0].data, "state": "preparing"}
            saved = await lab.download(run.id, (await lab.frames(run.id))[0].path, tmp_path)
            assert saved.is_file()
            async with lab.lease("Ada", 60.0):
                # At the same time, on one connection pool.
                position, settings = await asyncio.gather(
                    lab.stage_move("stage2", 3.0), lab.camera_settings(exposure_us=2500.0), return_exceptions=True
                )
                assert not isinstance(position, BaseException) or not isinstance(settings, BaseException)
            assert [event.id async for event in lab.events(after=0, limit=2)]
            with pytest.raises(ProblemError):
                await lab.run("20000101-000000-000000")

    asyncio.run(script())


def test_the_token_is_needed_and_its_file_has_to_be_there(rig: Client, tmp_path: Path) -> None:
    with Client(rig.url, "wrong-token-wrong-token-wrong-token") as stranger:
        assert stranger.health().status == "ok"
        with pytest.raises(ProblemError) as refused:
            stranger.rig()
        assert (refused.value.status, refused.value.kind) == (401, "unauthorized")
    with pytest.raises(TokenUnreadable, match=r"storage\.root"):
        Client(rig.url, tmp_path / "token")
    (tmp_path / "token").write_text("\n")
    with pytest.raises(TokenUnreadable, match="empty"):
        Client(rig.url, tmp_path / "token")
    for address in ("rig", "ftp://rig", "http://", ""):
        with pytest.raises(ClientError, match="address"):
            Client(address, "token")


def test_address_and_token_come_from_the_environment_where_none_are_given(
    rig: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("IRPMD_RIG_URL", rig.url)
    monkeypatch.setenv("IRPMD_RIG_TOKEN", str(tmp_path / "token"))
    with pytest.raises(TokenUnreadable, match="token"):
        Client()
    (tmp_path / "token").write_text("wrong-token-wrong-token-wrong-token\n")
    with Client() as lab:
        assert lab.url == rig.url
        with pytest.raises(ProblemError, match="token"):
            lab.rig()


def test_where_nobody_listens_the_client_says_how_to_start_one() -> None:
    with Client("http://127.0.0.1:1", "token") as client, pytest.raises(ServiceUnreachable, match="irpmd-rig serve"):
        client.rig()
