"""State, lease and stop."""

import httpx
import pytest
from service_world import API, RECIPE, Service, lease, slug

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.status import StopReport


def test_the_rig_tells_what_is_there_and_why_it_would_not_start(client: httpx.Client) -> None:
    rig = client.get(f"{API}/rig").json()
    assert set(rig["devices"]) == {"camera", "projector", "stage1", "stage2"}
    assert {device["state"] for device in rig["devices"].values()} == {"ready"}
    assert rig["axes"]["stage1"]["position"]["measured"] is True
    assert rig["simulated"] is True
    assert rig["can_start"] is False
    assert [reason for reason in rig["reasons"] if "queue is held" in reason]
    assert client.get(f"{API}/devices").json() == rig["devices"]


def test_two_clients_and_one_lease(service: Service, client: httpx.Client) -> None:
    ada = lease(client)
    with service.client() as other:
        refused = other.post(f"{API}/lease", json={"owner": "Bob"})
        assert refused.status_code == 409
        assert slug(refused) == "lease-held"
        assert refused.json()["holder"]["owner"] == "Ada"
        assert "Ada" in refused.json()["detail"]
        moved = other.post(f"{API}/devices/stage1/move", json={"position_mm": 1.0})
        assert slug(moved) == "lease-held"
        assert moved.json()["holder"]["owner"] == "Ada"
        taken = lease(other, "Bob", override=True)
        assert slug(client.put(f"{API}/lease", json={"duration_s": 5}, headers=ada)) == "lease-held"
        assert other.put(f"{API}/lease", json={"duration_s": 5}, headers=taken).json()["overridden"] == "Ada"
        assert other.delete(f"{API}/lease", headers=taken).status_code == 204
    assert client.get(f"{API}/rig").json()["lease"] is None


def test_the_id_of_a_lease_is_told_to_nobody_else(client: httpx.Client) -> None:
    held = lease(client)
    for path in (f"{API}/rig", "/metrics"):
        assert held["X-Lease"] not in client.get(path).text
    assert held["X-Lease"] not in client.post(f"{API}/lease", json={"owner": "Bob"}).text


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("PUT", "/lease", {}),
        ("DELETE", "/lease", None),
        ("POST", "/devices/camera/settings", {}),
        ("POST", "/devices/camera/frame", None),
        ("GET", "/devices/camera/live?limit=1", None),
        ("POST", "/devices/projector/show", {"picture": "white"}),
        ("POST", "/devices/projector/led", {"led": "infrared", "intensity": 0.1}),
        ("POST", "/devices/projector/park", {"parked": True}),
        ("POST", "/devices/stage1/move", {"position_mm": 1.0}),
        ("POST", "/devices/stage1/home", None),
        ("POST", "/devices/stage1/zero", {"position_mm": 0.0, "confirmed_by": "Ada"}),
        ("POST", "/devices/stage1/stop", None),
        ("POST", "/runs/20260101-000000-abcdef/actions", {"action": "abort"}),
    ],
)
def test_commands_need_the_lease(client: httpx.Client, method: str, path: str, body: object) -> None:
    answer = client.request(method, f"{API}{path}", json=body)
    assert answer.status_code == 428
    assert slug(answer) == "lease-needed"


def test_a_lease_makes_the_queue_wait(client: httpx.Client) -> None:
    held = lease(client)
    client.post(f"{API}/queue/actions", json={"action": "resume"})
    rig = client.get(f"{API}/rig").json()
    assert rig["can_start"] is False
    assert any("Ada" in reason for reason in rig["reasons"])
    client.delete(f"{API}/lease", headers=held)
    rig = client.get(f"{API}/rig").json()
    assert (rig["can_start"], rig["reasons"]) == (True, [])


def test_a_stop_needs_no_lease_and_stays(service: Service, client: httpx.Client, lab: WorldControl) -> None:
    held = lease(client)
    lit = client.post(f"{API}/devices/projector/led", json={"led": "infrared", "intensity": 0.4}, headers=held)
    assert lit.status_code == 204
    assert lab.call("state")["intensity"] == pytest.approx(0.4, abs=0.01)
    with service.client() as other:
        stopped = other.post(f"{API}/stop")
    assert stopped.status_code == 200
    assert {device["outcome"] for device in stopped.json()["devices"].values()} == {"stopped"}
    assert not lab.call("state")["intensity"]
    assert slug(client.post(f"{API}/devices/stage1/move", json={"position_mm": 1.0}, headers=held)) == "stopped"
    refused = client.post(f"{API}/queue/actions", json={"action": "resume"})
    assert slug(refused) == "not-ready"
    assert any("stopped" in reason for reason in refused.json()["reasons"])
    assert client.post(f"{API}/runs", json={"text": RECIPE}).status_code == 201
    assert client.delete(f"{API}/stop").status_code == 204
    assert client.get(f"{API}/rig").json()["stop_latched"] is False
    assert client.get(f"{API}/queue").json()["held"] is True


def test_figures_tell_of_rig_and_service(client: httpx.Client) -> None:
    client.get(f"{API}/runs/20260101-000000-abcdef")
    text = client.get("/metrics").text
    assert 'irpmd_rig_device_ready{device="camera"} 1.0' in text
    assert 'irpmd_rig_axis_position_millimetres{axis="stage1",measured="true"}' in text
    assert 'irpmd_rig_requests_total{method="GET",operation="run",status="404"}' in text
    assert "irpmd_rig_queue_held 1.0" in text
    assert "process_open_fds" in text


def test_what_cannot_be_stopped_says_when_it_ends(
    service: Service, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = {
        "stage1": StopReport(False, 3.5),
        "camera": StopReport(False, error="it is gone"),
        "stage2": StopReport(True),
    }
    monkeypatch.setattr(service.daemon, "stop", lambda: told)
    assert client.post(f"{API}/stop").json() == {
        "devices": {
            "stage1": {"outcome": "cannot_be_stopped", "ends_in_s": 3.5, "error": None},
            "camera": {"outcome": "unknown", "ends_in_s": 0.0, "error": "it is gone"},
            "stage2": {"outcome": "stopped", "ends_in_s": 0.0, "error": None},
        },
        "stop_latched": True,
    }
