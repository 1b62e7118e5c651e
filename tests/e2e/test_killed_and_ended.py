"""A daemon that is killed, ends, hangs, or does not obey: what is left on disk, and what the hardware does."""

import signal
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

from irpmd_rig.service.notify import Notifier
from irpmd_rig.service.server import Server
from tests.campaigns.lab import Daemon, Lab, until
from tests.campaigns.on_disk import complaints, durable_frames, lost_frames, states
from tests.campaigns.recipes import CHAIN, stations

PLACES_MM = range(0, 36, 3)
LONG = stations(*PLACES_MM, wait_s=0.1)
WATCHDOG_S = 2.0


def test_after_a_kill_the_next_start_makes_the_rig_safe_and_a_retry_completes_the_run(lab: Lab) -> None:
    with lab.daemon() as daemon:
        run_id = daemon.begin(LONG, frames=12)
        daemon.kill()
    folder = lab.root / run_id
    durable = durable_frames(folder)
    assert len(durable) >= 12
    with lab.daemon() as daemon:
        lab.at_rest()
        run = daemon.client.run(run_id)
        assert (run.state, run.reason, run.attempt) == ("interrupted", "daemon_restarted", 1)
        assert lost_frames(folder, durable) == []
        assert complaints(folder) == []
        assert len(daemon.client.frames(run_id)) == run.frames == len(list((folder / "frames").iterdir()))
        queue = daemon.client.queue()
        assert queue.held
        assert run_id in queue.why
        time.sleep(0.5)
        assert daemon.client.run(run_id).state == "interrupted"
        lab.at_rest()
        run = daemon.retry(run_id)
        assert (run.state, run.attempt, run.frames) == ("succeeded", 2, 6 * len(PLACES_MM)), run.detail
        assert complaints(folder) == []
        assert lost_frames(folder, durable) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_daemon_that_ends_turns_leds_off_and_stops_stages(lab: Lab, number: int) -> None:
    with lab.daemon() as daemon:
        run_id = daemon.begin(LONG)
        assert daemon.terminate(number) == 0
        lab.at_rest()
    last = states(lab.root / run_id)[-1]
    assert (last["state"], last["reason"]) == ("interrupted", "daemon_restarted")
    assert complaints(lab.root / run_id) == []


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[tuple[socket.socket, dict[str, str]]]:
    """The socket of a service manager, and what it gives a service to know."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "notify"))
        line.settimeout(30.0)
        yield line, {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": str(int(1e6 * WATCHDOG_S))}


def silence(line: socket.socket) -> bool:
    """Whether the watchdog hears nothing for longer than it allows."""
    line.settimeout(0.0)
    try:
        while True:
            line.recv(4096)
    except BlockingIOError:
        pass
    line.settimeout(WATCHDOG_S)
    try:
        line.recv(4096)
    except TimeoutError:
        return True
    return False


def test_a_daemon_that_hangs_is_noticed_killed_and_cleaned_up_after(
    lab: Lab, manager: tuple[socket.socket, dict[str, str]]
) -> None:
    line, environment = manager
    with lab.daemon(environment=environment) as daemon:
        while b"READY=1" not in line.recv(4096):
            pass
        run_id = daemon.begin(LONG)
        assert not silence(line)
        # What any service manager does then: see the unit file.
        psutil.Process(daemon.pid).suspend()
        assert silence(line)
        daemon.kill()
    made_safe = lab.command("safe", str(lab.rig))
    assert made_safe.returncode == 0, made_safe.stderr
    lab.at_rest()
    assert lost_frames(lab.root / run_id, durable_frames(lab.root / run_id)) == []


def test_the_watchdog_is_fed_by_the_event_loop_itself(manager: tuple[socket.socket, dict[str, str]]) -> None:
    import asyncio

    line, environment = manager
    hanging = threading.Event()

    async def hangs(scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] == "lifespan":
            await receive()
            await send({"type": "lifespan.startup.complete"})
            await receive()
            await send({"type": "lifespan.shutdown.complete"})
            return
        hanging.set()
        time.sleep(3 * WATCHDOG_S)
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    with socket.create_server(("127.0.0.1", 0)) as place:
        server = Server(hangs, place, Notifier(environment))
        thread = threading.Thread(target=asyncio.run, args=(server.serve(),))
        thread.start()
        try:
            until(lambda: server.started, 60.0, "the start")
            assert not silence(line)
            asking = threading.Thread(target=httpx.get, args=(server.url,), kwargs={"trust_env": False, "timeout": 60})
            asking.start()
            assert hanging.wait(30)
            assert silence(line)
            asking.join(60)
            assert not silence(line)
        finally:
            server.ask_to_end()
            thread.join(60)


@pytest.fixture(scope="module")
def running(lab: Lab) -> Iterator[Daemon]:
    with lab.daemon() as daemon:
        yield daemon


def test_a_stop_that_a_hanging_camera_does_not_obey_is_bounded(lab: Lab, daemon: Daemon) -> None:
    camera = daemon.helpers()["camera"]
    run_id = daemon.begin(LONG)
    camera.suspend()
    began_s = time.monotonic()
    stop = daemon.client.stop()
    assert time.monotonic() - began_s < 60.0
    assert stop.devices["projector"].outcome == stop.devices["stage1"].outcome == "stopped"
    run = daemon.ended(run_id, 30.0)
    assert (run.state, run.reason) == ("failed", "stopped"), run.detail
    state = lab.state()
    assert not state["led"] or not state["intensity"]
    assert not any(stage["moving"] for stage in state["stages"].values())
    assert any("stop" in reason for reason in daemon.client.rig().reasons)
    daemon.client.clear_stop()
    daemon.ready()
    lab.at_rest()
    until(lambda: "camera" in daemon.helpers(), 60.0, "another camera process")
    assert daemon.helpers()["camera"].pid != camera.pid
    assert daemon.carry_out(stations(0)).state == "succeeded"


def test_a_computing_process_that_does_not_obey_is_killed(lab: Lab, daemon: Daemon) -> None:
    run_id = daemon.submit(CHAIN[0])
    computing = daemon.helpers()["processing"]
    computing.suspend()
    daemon.resume()
    until(lambda: daemon.client.run(run_id).state == "reconstructing", 60.0, "the computing")
    began_s = time.monotonic()
    with daemon.lease():
        daemon.client.act(run_id, "abort")
        run = daemon.ended(run_id, 60.0)
    assert time.monotonic() - began_s < 60.0
    assert (run.state, run.reason, run.results) == ("aborted", "aborted_by_user", ()), run.detail
    assert not computing.is_running() or computing.status() == psutil.STATUS_ZOMBIE
    assert complaints(lab.root / run_id) == []
    run = daemon.retry(run_id)
    assert (run.state, run.attempt) == ("succeeded", 2), run.detail
    assert "calibration.json" in run.results
