"""Who is answered at all, and what a request has to look like."""

import asyncio
import json
import re
import socket
from collections.abc import Iterator
from urllib.parse import urlsplit

import httpx
import pytest
from service_world import API, TOKEN, Service, slug

from irpmd_rig.service import ServiceSettings
from irpmd_rig.service.openapi import document
from irpmd_rig.service.security import Guard

OPERATIONS = [
    (method.upper(), re.sub(r"\{.*?\}", "x", path))
    for path, operations in document()["paths"].items()
    for method in operations
]


def raw(service: Service, request: str) -> str:
    """Send what no client would."""
    address = urlsplit(service.url)
    with socket.create_connection((str(address.hostname), address.port or 0), timeout=60) as line:
        line.sendall(request.encode())
        line.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: line.recv(65536), b"")).decode()


@pytest.fixture
def stranger(service: Service) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, trust_env=False, verify=False) as client:
        yield client


def test_only_the_health_check_answers_without_token(stranger: httpx.Client) -> None:
    assert len(OPERATIONS) > 30
    for method, path in OPERATIONS:
        answer = stranger.request(method, path)
        if path.endswith("/health"):
            assert answer.json() == {"status": "ok"}
        else:
            assert slug(answer) == "unauthorized", path
            assert answer.headers["www-authenticate"].startswith("Bearer")
    for path in ("/", "/nowhere", "/metrics", f"{API}/openapi.json", "/docs", "/problems/unauthorized"):
        assert slug(stranger.get(path)) == "unauthorized"


@pytest.mark.parametrize(
    "given", ["Bearer", f"Basic {TOKEN}", f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", TOKEN, "Bearer é"]
)
def test_a_wrong_token_is_refused(stranger: httpx.Client, given: str) -> None:
    headers = {"Authorization": given.encode("latin-1")}
    assert slug(stranger.get(f"{API}/rig", headers=headers)) == "unauthorized"


def test_two_tokens_are_refused(stranger: httpx.Client) -> None:
    headers = [("Authorization", f"Bearer {TOKEN}"), ("Authorization", f"Bearer {TOKEN}")]
    assert slug(stranger.get(f"{API}/rig", headers=headers)) == "unauthorized"


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8321", "127.0.0.1.evil.example", "localhost@evil", "", "[::2]"]
)
def test_a_foreign_host_is_refused(client: httpx.Client, host: str) -> None:
    assert slug(client.get(f"{API}/health", headers={"Host": host})) == "foreign-host"


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:1", "127.0.0.1:80", "[::1]:8321"])
def test_own_names_are_answered(client: httpx.Client, host: str) -> None:
    assert client.get(f"{API}/rig", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize(
    "header",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://[evil"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_a_foreign_page_is_refused(client: httpx.Client, header: dict[str, str]) -> None:
    assert slug(client.post(f"{API}/stop", headers=header)) == "foreign-origin"
    assert client.get(f"{API}/rig").json()["stop_latched"] is False


def test_a_page_of_the_service_is_answered(service: Service, client: httpx.Client) -> None:
    header = {"Origin": service.url, "Sec-Fetch-Site": "same-origin"}
    answer = client.get(f"{API}/rig", headers=header)
    assert answer.status_code == 200
    assert not any(name.startswith("access-control") for name in answer.headers)


def test_a_preflight_of_another_origin_is_refused(client: httpx.Client) -> None:
    header = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    assert slug(client.request("OPTIONS", f"{API}/stop", headers=header)) == "foreign-origin"


@pytest.mark.parametrize(
    "kind",
    [None, "text/plain", "application/x-www-form-urlencoded", "application/jsonp", "application/json; charset=latin-1"],
)
def test_bodies_are_json(client: httpx.Client, kind: str | None) -> None:
    headers = {} if kind is None else {"Content-Type": kind}
    answer = client.post(f"{API}/lease", content=b'{"owner": "Ada"}', headers=headers)
    assert slug(answer) == "not-json"
    assert client.get(f"{API}/rig").json()["lease"] is None


@pytest.mark.parametrize("body", ["", "{", "[1", '{"owner": }', '{"owner": "Ada"} x', "[" * 100_000, "9" * 10_000])
def test_what_is_not_json_is_said_to_be_none(client: httpx.Client, body: str) -> None:
    answer = client.post(f"{API}/lease", content=body, headers={"Content-Type": "application/json"})
    assert slug(answer) == ("malformed-json" if body else "invalid")


@pytest.mark.parametrize(
    "body",
    [
        '{"owner": "Ada", "duration_s": NaN}',
        '{"owner": "Ada", "duration_s": 1e999}',
        r'{"owner": "\ud800"}',
        r'{"owner": "Ada", "\ud800": 1}',
        '{"owner": "Ada", "overide": true}',
        '{"owner": 7}',
        '{"owner": "\\u0000"}',
        '{"owner": " "}',
        "[]",
        "null",
        '"Ada"',
    ],
)
def test_every_error_of_a_body_is_placed(client: httpx.Client, body: str) -> None:
    answer = client.post(f"{API}/lease", content=body, headers={"Content-Type": "application/json"})
    assert slug(answer) == "invalid"
    assert answer.json()["detail"]


def test_all_errors_are_told_at_once(client: httpx.Client) -> None:
    answer = client.post(f"{API}/lease", json={"duration_s": -1, "nix": 1})
    places = [error["location"] for error in answer.json()["errors"]]
    assert sorted(places) == [["body", "duration_s"], ["body", "nix"], ["body", "owner"]]


def test_a_large_body_is_refused_before_it_is_read(service: Service) -> None:
    head = f"POST {API}/runs HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n"
    head += "Content-Type: application/json\r\nConnection: close\r\n"
    assert "413" in raw(service, f"{head}Content-Length: 99999999999\r\n\r\n").splitlines()[0]


def test_a_large_body_in_pieces_is_refused(client: httpx.Client) -> None:
    pieces = (b"x" * 100_000 for _ in range(20))
    answer = client.post(f"{API}/runs", content=pieces, headers={"Content-Type": "application/json"})
    assert slug(answer) == "body-too-large"


def test_a_body_that_does_not_come_is_not_waited_for() -> None:
    async def ask() -> list[int]:
        async def never() -> dict[str, object]:
            return await asyncio.Future()

        async def send(message: dict[str, object]) -> None:
            if message["type"] == "http.response.start":
                told.append(int(str(message["status"])))

        told: list[int] = []
        headers = {"host": "localhost", "authorization": f"Bearer {TOKEN}", "content-length": "5"}
        scope = {
            "type": "http",
            "path": "/x",
            "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
        }
        guard = Guard(never, ServiceSettings(TOKEN, body_limit_s=0.05))  # type: ignore[arg-type]
        await guard(scope, never, send)  # type: ignore[arg-type]
        return told

    assert asyncio.run(ask()) == [408]


def test_other_addresses_and_methods_are_problems(client: httpx.Client) -> None:
    assert slug(client.get("/nowhere")) == "not-found"
    assert slug(client.get(f"{API}/rig/")) == "not-found"
    answer = client.delete(f"{API}/rig")
    assert slug(answer) == "method-not-allowed"
    assert answer.headers["allow"] == "GET"
    assert slug(client.request("BREW", f"{API}/rig")) == "method-not-allowed"


def test_a_web_socket_is_refused(service: Service) -> None:
    upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: eA==\r\n"
    head = f"GET {API}/events HTTP/1.1\r\nHost: localhost\r\n{upgrade}\r\n"
    assert "401" in raw(service, head).splitlines()[0]


def test_answers_are_hardened(client: httpx.Client) -> None:
    for path in (f"{API}/rig", "/nowhere"):
        answer = client.get(path)
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"


def test_problem_pages_explain_every_type(client: httpx.Client) -> None:
    answer = client.get("/nowhere")
    page = client.get(answer.json()["type"])
    assert page.headers["content-type"].startswith("text/html")
    assert answer.json()["title"] in page.text
    assert slug(client.get("/problems/nix")) == "not-found"
    assert slug(client.get("/problems/%3Cscript%3E")) == "not-found"


def test_the_token_stands_in_no_text_of_the_settings() -> None:
    assert TOKEN not in repr(ServiceSettings(TOKEN))
    assert json.dumps(sorted(ServiceSettings(TOKEN, host="0.0.0.0", allowed_hosts=("Lab",)).names)) == json.dumps(
        ["127.0.0.1", "::1", "lab", "localhost"]
    )
