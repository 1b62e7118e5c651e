"""Server-sent events."""

import json
import socket
import threading
import time
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from service_world import API, RECIPE, TOKEN, Service, lease, slug

from tests.small_world import until


def events_in(text: str) -> list[dict[str, Any]]:
    found = []
    for block in text.replace("\r\n", "\n").split("\n\n"):
        lines = dict(line.split(": ", 1) for line in block.splitlines() if line and not line.startswith(":"))
        if lines:
            event = json.loads(lines["data"])
            assert (str(event["id"]), event["kind"]) == (lines["id"], lines["event"])
            found.append(event)
    return found


def test_events_come_as_they_happen_and_can_be_resumed(service: Service, client: httpx.Client) -> None:
    with service.client() as other, other.stream("GET", f"{API}/events?limit=2") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        pieces = stream.iter_text()
        assert next(pieces).startswith(":")
        held = lease(client)
        client.delete(f"{API}/lease", headers=held)
        first, second = events_in("".join(pieces))
    assert (first["kind"], first["data"]["owner"]) == ("lease", "Ada")
    assert (second["kind"], second["data"]["owner"]) == ("lease", None)
    assert second["id"] == first["id"] + 1
    again = client.get(f"{API}/events?limit=1", headers={"Last-Event-ID": str(first["id"])})
    assert events_in(again.text) == [second]


def test_what_was_missed_is_told(client: httpx.Client) -> None:
    client.post(f"{API}/queue/actions", json={"action": "hold"})
    answer = client.get(f"{API}/events?limit=2", headers={"Last-Event-ID": "7"})
    assert events_in(answer.text)[0]["kind"] == "gap"


def test_a_stream_of_a_run_holds_that_run_alone(service: Service, client: httpx.Client) -> None:
    one = client.post(f"{API}/runs", json={"text": RECIPE}).json()["id"]
    with service.client() as other, other.stream("GET", f"{API}/runs/{one}/events?limit=3") as stream:
        pieces = stream.iter_text()
        next(pieces)
        client.post(f"{API}/runs", json={"text": RECIPE})
        client.post(f"{API}/queue/actions", json={"action": "resume"})
        found = events_in("".join(pieces))
    assert {event["run_id"] for event in found} == {one}
    assert next(event["data"]["state"] for event in found if event["kind"] == "state") == "preparing"


@pytest.mark.parametrize("headers", [{"Last-Event-ID": "x"}, {"Last-Event-ID": "-1"}, {"Last-Event-ID": "9" * 30}])
def test_other_ids_are_refused(client: httpx.Client, headers: dict[str, str]) -> None:
    assert slug(client.get(f"{API}/events?limit=1", headers=headers)) == "invalid"


def test_a_reader_that_reads_nothing_holds_nobody_up(service: Service, client: httpx.Client) -> None:
    address = urlsplit(service.url)
    with socket.create_connection((str(address.hostname), address.port or 0), timeout=60) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
        head = f"GET {API}/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\r\n"
        line.sendall(head.encode())
        line.recv(100)
        began_s = time.perf_counter()
        for _ in range(20_000):
            service.daemon.events.announce("queue", held=True, why="x" * 1000, waiting=[])
        assert time.perf_counter() - began_s < 60.0
        assert client.get(f"{API}/rig").status_code == 200
        # It then reads on, and is told how much it missed.
        seen = b""
        while b"event: gap" not in seen:
            seen = seen[-20:] + line.recv(1 << 20)


def test_streams_are_bounded(service: Service, client: httpx.Client) -> None:
    with service.client(limits=httpx.Limits(max_connections=None)) as many:
        streams = [many.stream("GET", f"{API}/events") for _ in range(32)]
        opened = [stream.__enter__() for stream in streams]
        assert {answer.status_code for answer in opened} == {200}
        refused = client.get(f"{API}/events?limit=1")
        assert slug(refused) == "too-busy"
        assert refused.headers["retry-after"] == "5"
        for stream in streams:
            stream.__exit__(None, None, None)
    until(lambda: "irpmd_rig_streams 0.0" in client.get("/metrics").text)


def test_many_readers_each_get_everything(service: Service) -> None:
    texts: list[str] = []
    ready = threading.Barrier(5)

    def read() -> None:
        with service.client() as client, client.stream("GET", f"{API}/events?limit=50") as stream:
            pieces = stream.iter_text()
            next(pieces)
            ready.wait(60)
            texts.append("".join(pieces))

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    ready.wait(60)
    told = [service.daemon.events.announce("queue", number=number).id for number in range(50)]
    for thread in threads:
        thread.join(60)
    assert [[event["id"] for event in events_in(text)] for text in texts] == [told] * 4
