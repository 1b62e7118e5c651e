"""Two clients, foreign ones, and names that lead elsewhere."""

import json
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from irpmd_rig.client import Client, ProblemError
from tests.campaigns.lab import OWNER, Daemon, Lab
from tests.campaigns.on_disk import complaints
from tests.campaigns.recipes import stations

SHORT = stations(0, pattern="white")
API = "/api/v1"


@pytest.fixture
def token(lab: Lab, daemon: Daemon) -> str:
    return (lab.seen_by(daemon.pid) / "token").read_text().strip()


@pytest.fixture
def other(daemon: Daemon, token: str) -> Iterator[Client]:
    with Client(daemon.client.url, token) as client:
        yield client


@pytest.fixture
def raw(daemon: Daemon, token: str) -> Iterator[httpx.Client]:
    headers = {"Authorization": f"Bearer {token}"}
    with httpx.Client(base_url=daemon.client.url, headers=headers, trust_env=False, timeout=60.0) as client:
        yield client


def test_only_one_of_two_clients_controls_the_rig_and_either_may_stop_it(
    lab: Lab, daemon: Daemon, other: Client
) -> None:
    with daemon.lease():
        before = lab.state()["stages"]["stage1"]["position_mm"]
        for command in (
            lambda: other.take_lease("Bertha"),
            lambda: other.stage_move("stage1", before + 5.0),
            lambda: other.projector_led("infrared", 0.5),
        ):
            with pytest.raises(ProblemError) as caught:
                command()
            assert (caught.value.status, caught.value.extras["holder"]["owner"]) == (409, OWNER)
        assert lab.state()["stages"]["stage1"]["position_mm"] == before
        daemon.client.projector_show("white")
        daemon.client.projector_led("infrared", 0.5)
        assert lab.state()["led"] == "infrared"
        assert all(device.outcome == "stopped" for device in other.stop().devices.values())
        lab.at_rest()
        with pytest.raises(ProblemError):
            daemon.client.stage_move("stage1", before + 5.0)
    other.clear_stop()
    with other.lease("Bertha"):
        assert other.rig().lease is not None


def test_a_request_that_is_sent_again_makes_no_second_run(lab: Lab, daemon: Daemon, other: Client) -> None:
    first = daemon.submit(SHORT, "a key")
    assert daemon.submit(SHORT, "a key") == other.submit(SHORT, idempotency_key="a key").id == first
    with pytest.raises(ProblemError) as caught:
        daemon.submit(stations(1, pattern="white"), "a key")
    assert caught.value.status in (409, 422)
    daemon.resume()
    assert daemon.ended(first).state == "succeeded"
    assert daemon.submit(SHORT, "a key") == first
    assert len([run for run in daemon.client.runs() if run.state == "queued"]) == 0
    assert complaints(lab.root / first) == []


def test_names_lead_nowhere_but_into_the_store(lab: Lab, daemon: Daemon, raw: httpx.Client) -> None:
    run = daemon.carry_out(SHORT)
    secret = lab.folder / "secret.json"
    secret.write_text("{}")
    results = lab.root / run.id / "results"
    results.mkdir(exist_ok=True)
    (results / "link.json").symlink_to(secret)
    (lab.root / "20260101-000000-abcdef").symlink_to(lab.folder)
    try:
        for path in (
            f"runs/{run.id}/results/link.json",
            f"runs/{run.id}/results/..%2f..%2ftoken",
            f"runs/{run.id}/results/../../token",
            f"runs/{run.id}/frames/..%2frun.yaml",
            f"runs/{run.id}/frames/%2fetc%2fpasswd",
            f"runs/..%2f{lab.root.name}%2f{run.id}",
            "runs/20260101-000000-abcdef",
            "runs/.daemon.lock",
        ):
            answer = raw.get(f"{API}/{path}")
            assert answer.status_code in (404, 422), (path, answer.text)
            assert answer.headers["content-type"] == "application/problem+json"
        for name in ("../rigs/sim", "/etc/passwd", "..", str(lab.rig)):
            answer = raw.post(f"{API}/runs", json={"recipe": name})
            assert answer.status_code in (404, 422), (name, answer.text)
        answer = raw.delete(f"{API}/runs/20260101-000000-abcdef")
        assert answer.status_code in (404, 422)
    finally:
        (lab.root / "20260101-000000-abcdef").unlink()
        (results / "link.json").unlink()
    assert secret.exists()
    assert lab.rig.exists()


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "rig.example.org"}, 403),
        ({"Host": "rig.example.org:80"}, 403),
        ({"Origin": "http://rig.example.org"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Authorization": ""}, 401),
        ({"Authorization": "Bearer 0123456789abcdef0123456789abcdef"}, 401),
        ({"Content-Type": "text/plain"}, 415),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415),
    ],
)
def test_foreign_requests_are_refused_and_do_nothing(
    lab: Lab, daemon: Daemon, raw: httpx.Client, headers: dict[str, str], status: int
) -> None:
    before = sorted(path.name for path in lab.root.iterdir())
    content: Any = json.dumps({"text": SHORT})
    for path in ("runs", "stop", "queue/actions"):
        answer = raw.post(f"{API}/{path}", content=content, headers={"Content-Type": "application/json"} | headers)
        assert answer.status_code == status, (path, answer.text)
        assert answer.headers["content-type"] == "application/problem+json"
    assert sorted(path.name for path in lab.root.iterdir()) == before
    assert not daemon.client.rig().stop_latched
