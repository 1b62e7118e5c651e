"""Events over a line that breaks: a server of the test's own says what it wants and hangs up when it wants."""

import asyncio
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from irpmd_rig.client import AsyncClient, Client, ClientError, ProblemError, ServiceUnreachable
from irpmd_rig.client.stream import EventReader, Place

RUN = "20261122-101500-3fa1c2"
Answer = Callable[[BaseHTTPRequestHandler], None]


def event(number: int, **data: object) -> bytes:
    content = {"id": number, "time_s": 1.5, "kind": "state", "run_id": RUN, "data": data}
    return f"id: {number}\r\nevent: state\r\ndata: {json.dumps(content, ensure_ascii=False)}\r\n\r\n".encode()


@contextmanager
def answering(*answers: Answer) -> Iterator[tuple[str, list[tuple[str, str | None]]]]:
    """Serve one answer a request, the last one again and again; yields the address and what was asked."""
    asked: list[tuple[str, str | None]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append((self.path, self.headers["Last-Event-ID"]))
            answers[min(len(asked), len(answers)) - 1](self)
            self.close_connection = True

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", asked
        finally:
            server.shutdown()
            thread.join()


def streaming(*pieces: bytes, promised: int | None = None) -> Answer:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        if promised is not None:
            handler.send_header("Content-Length", str(promised))
        handler.end_headers()
        for piece in pieces:
            handler.wfile.write(piece)

    return answer


def saying(status: int, content: bytes, media_type: str) -> Answer:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        handler.send_header("Content-Type", media_type)
        handler.end_headers()
        handler.wfile.write(content)

    return answer


def test_events_are_cut_out_of_whatever_pieces_come() -> None:
    # Characters that end lines elsewhere, and a ping between.
    stream = event(1, text="an end \u2028 of \x85 lines") + b": ping\r\n\r\n" + event(2)
    for length in (1, 2, 7, len(stream)):
        reader = EventReader()
        found = [one for k in range(0, len(stream), length) for one in reader.feed(stream[k : k + length])]
        assert [one.id for one in found] == [1, 2]
        assert found[0].data["text"] == "an end \u2028 of \x85 lines"


def test_what_is_no_event_is_said() -> None:
    with pytest.raises(ClientError, match="one version"):
        EventReader().feed(b'data: {"id": "none"}\n')


def test_a_broken_line_is_mended_where_it_broke() -> None:
    # The second connection ends in the middle of an event, which is then read again whole.
    cut = event(4)[:30]
    answers = (streaming(event(1), event(2), cut, promised=9999), streaming(event(3), cut), streaming(event(4)))
    with answering(*answers) as (url, asked), Client(url, "token") as client:
        assert [one.id for one in client.events(limit=4)] == [1, 2, 3, 4]
    assert asked == [("/api/v1/events", None), ("/api/v1/events", "2"), ("/api/v1/events", "3")]


def test_a_broken_line_is_mended_on_asyncio_too() -> None:
    async def read(url: str) -> list[int]:
        async with AsyncClient(url, "token") as client:
            return [one.id async for one in client.events(RUN, after=7, limit=2)]

    with answering(streaming(event(8), promised=9999), streaming(event(9))) as (url, asked):
        assert asyncio.run(read(url)) == [8, 9]
    assert asked == [(f"/api/v1/runs/{RUN}/events", "7"), (f"/api/v1/runs/{RUN}/events", "8")]


def test_patience_has_an_end() -> None:
    place = Place(patience_s=0.0)
    error = ServiceUnreachable("http://rig", "gone")
    place.pause_s(error)
    with pytest.raises(ServiceUnreachable, match="gone"):
        place.pause_s(error)
    # Once it answers, patience begins anew.
    place.connected()
    assert place.pause_s(error) > 0.0


def test_a_problem_ends_the_stream_at_once() -> None:
    problem = {"type": "/problems/no-such-run", "title": "There is no such run", "status": 404, "detail": "none"}
    answer = saying(404, json.dumps(problem).encode(), "application/problem+json")
    with answering(answer) as (url, asked), Client(url, "token") as client:
        with pytest.raises(ProblemError, match="no such run"):
            next(client.events(RUN))
        assert len(asked) == 1


@pytest.mark.parametrize("content", [b"<html>proxy</html>", b"[]", b'{"no": "problem"}', b"\xff"])
def test_another_program_at_the_port_is_no_daemon(content: bytes) -> None:
    answers = saying(502, content, "text/html"), saying(200, content, "text/html")
    with answering(*answers) as (url, _), Client(url, "token") as client:
        with pytest.raises(ProblemError) as refused:
            client.rig()
        assert (refused.value.status, refused.value.kind) == (502, "about:blank")
        with pytest.raises(ClientError, match="one version"):
            client.rig()
