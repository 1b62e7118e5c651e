"""The daemon as a process: how it starts, what supervises it, how it ends."""

import json
import os
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from service_world import API, daemon_command, rig_file_text

from irpmd_rig.acquisition.control import WorldControl
from tests.small_world import until, world


class Process:
    """A daemon in a process of its own, and what it logged."""

    def __init__(self, rig: Path, folder: Path, **environment: str) -> None:
        self.log = folder / "log.jsonl"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(daemon_command(rig), stderr=log, env=os.environ | environment)

    def lines(self) -> list[dict[str, Any]]:
        # The last line may still be on its way.
        return [json.loads(line) for line in self.log.read_bytes().split(b"\n")[:-1] if line]

    def url(self) -> str:
        told: list[str] = []

        def answers() -> bool:
            assert self.process.poll() is None, self.log.read_text()
            told.extend(
                line["event"].removeprefix("answers at ")
                for line in self.lines()
                if line["event"].startswith("answers at ")
            )
            return bool(told)

        until(answers, 60.0)
        return told[0]

    def end(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(60)


@contextmanager
def process(rig: Path, folder: Path, **environment: str) -> Iterator[Process]:
    made = Process(rig, folder, **environment)
    try:
        yield made
    finally:
        if made.process.poll() is None:
            made.process.kill()
        made.process.wait(60)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    """A world that no other daemon has."""
    with world(tmp_path_factory.mktemp("lab") / "world") as control:
        yield control


@pytest.fixture
def rig(lab: WorldControl, tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_file_text(lab.folder, tmp_path / "store"))
    return path


def client(url: str, token: str = "") -> httpx.Client:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    return httpx.Client(base_url=url, headers=headers, trust_env=False, verify=False, timeout=60.0)


class Manager:
    """Takes what a service tells systemd."""

    def __init__(self, path: Path) -> None:
        self.told: list[str] = []
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._line.bind(str(path))
        self._thread = threading.Thread(target=self._take)
        self._thread.start()

    def _take(self) -> None:
        while told := self._line.recv(4096):
            self.told.append(told.decode())

    def count(self, what: str) -> int:
        return sum(what in told.splitlines() for told in self.told)

    def __enter__(self) -> "Manager":
        return self

    def __exit__(self, *_: object) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
            end.sendto(b"", self._line.getsockname())
        self._thread.join(60)
        self._line.close()


def test_it_is_supervised_answers_and_ends_at_rest(rig: Path, tmp_path: Path, lab: WorldControl) -> None:
    watched = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "300000"}
    with Manager(tmp_path / "notify") as manager, process(rig, tmp_path, **watched) as daemon:
        url = daemon.url()
        until(lambda: manager.count("READY=1") == 1)
        assert manager.count(f"STATUS=answers at {url}") == 1
        token_file = tmp_path / "store" / "token"
        assert token_file.stat().st_mode & 0o777 == 0o600
        with client(url, token_file.read_text().strip()) as asker:
            assert asker.get("/health").json() == {"status": "ok"}
            held = {"X-Lease": asker.post(f"{API}/lease", json={"owner": "Ada"}).json()["id"]}
            lit = {"led": "infrared", "intensity": 0.3}
            assert asker.post(f"{API}/devices/projector/led", json=lit, headers=held).status_code == 204
            assert lab.call("state")["intensity"] == pytest.approx(0.3, abs=0.01)
            # Fed by the event loop.
            until(lambda: manager.count("WATCHDOG=1") >= 3)
            second = subprocess.run(daemon_command(rig), capture_output=True, text=True, timeout=60)
            assert second.returncode != 0
            assert "another daemon works on" in second.stderr
            with asker.stream("GET", f"{API}/events") as events:
                # An open stream does not keep it from ending.
                next(events.iter_raw())
                assert daemon.end() == 0
        assert manager.count("STOPPING=1") == 1
    state = lab.call("state")
    assert not state["intensity"]
    assert not any(stage["moving"] for stage in state["stages"].values())
    requests = [line for line in daemon.lines() if line["event"] == "request"]
    assert {"method", "path", "status", "milliseconds", "timestamp", "level", "logger"} <= requests[0].keys()
    assert token_file.read_text().strip() not in daemon.log.read_text()
    assert held["X-Lease"] not in daemon.log.read_text()


def test_a_broken_rig_file_is_told_and_does_not_end_it(rig: Path, tmp_path: Path) -> None:
    rig.write_text(rig.read_text().replace("trigger: hardware", "trigger: hardwear\nlight: {led: ultraviolet}"))
    with process(rig, tmp_path) as daemon:
        url = daemon.url()
        with client(url) as asker:
            for method, path in (("GET", "/health"), ("GET", f"{API}/rig"), ("POST", f"{API}/stop"), ("GET", "/")):
                answer = asker.request(method, path)
                assert answer.status_code == 503
                assert answer.headers["content-type"] == "application/problem+json"
                document = answer.json()
                assert document["type"] == "/problems/not-started"
                assert {error["file"] for error in document["errors"]} == {str(rig)}
                assert all(error["line"] > 0 and error["remedy"] for error in document["errors"])
            page = asker.get("/", headers={"Accept": "text/html,*/*"})
            first = document["errors"][0]
            place = f"{rig}:{first['line']}:{first['column']}"
            assert place in page.text
            assert asker.get("/", headers={"Host": "evil.example"}).status_code == 403
        assert any(place in line["event"] for line in daemon.lines())
        assert daemon.end() == 0


def test_a_world_that_is_not_there_is_told_as_well(rig: Path, tmp_path: Path) -> None:
    rig.write_text(rig.read_text().replace("simulation: {folder: ", "simulation: {folder: /nowhere"))
    with process(rig, tmp_path) as daemon, client(daemon.url()) as asker:
        assert "no world answers" in asker.get(f"{API}/rig").json()["detail"]
        assert daemon.end() == 0


def test_it_can_be_ended_while_it_starts(rig: Path, tmp_path: Path) -> None:
    with process(rig, tmp_path) as daemon:
        until(lambda: (tmp_path / "store").exists(), 60.0)
        assert daemon.end() in (0, 128 + signal.SIGTERM)
