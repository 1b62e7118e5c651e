"""Who may speak to the service at all: looked at before anything else of it sees a request."""

from __future__ import annotations

import asyncio
import re
import secrets
from email.message import Message as MailMessage
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from irpmd_rig.service.problems import Problem
from irpmd_rig.service.settings import ServiceSettings

OPEN_PATHS = frozenset({"/health", "/api/v1/health"})
# A name or an address, in brackets if it is IPv6, and a port.
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"x-frame-options", b"DENY"),
)


class Guard:
    """ASGI middleware: refuses foreign hosts, foreign origins, requests without the token, and unfit bodies.

    Parameters
    ----------
    app
        What is guarded.
    settings
        Names, token and limits.
    """

    def __init__(self, app: ASGIApp, settings: ServiceSettings) -> None:
        self._app = app
        self._settings = settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it with a problem."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            # There are no web sockets here.
            await send({"type": "websocket.close", "code": 1008})
            return
        headers = Headers(scope=scope)
        problem = self._refused(headers, scope["path"])
        if problem is None:
            body = await self._body(headers, receive)
            if isinstance(body, Problem):
                problem = body
            else:
                receive = _again(body, receive)
        if problem is not None:
            await problem.response(scope["path"])(scope, receive, _hardened(send))
        else:
            await self._app(scope, receive, _hardened(send))

    def _refused(self, headers: Headers, path: str) -> Problem | None:
        problem = foreign(headers, self._settings)
        if problem is not None:
            return problem
        if path not in OPEN_PATHS and not self._has_token(headers):
            return Problem(
                "unauthorized",
                "give the token: Authorization: Bearer ...",
                headers={"WWW-Authenticate": 'Bearer realm="irpmd-rig"'},
            )
        return None

    def _has_token(self, headers: Headers) -> bool:
        given = headers.getlist("authorization")
        if len(given) != 1:
            return False
        scheme, _, token = given[0].partition(" ")
        # In constant time, and in bytes: a header may hold any.
        same = secrets.compare_digest(token.strip().encode("latin-1", "replace"), self._settings.token.encode())
        return scheme.lower() == "bearer" and same

    async def _body(self, headers: Headers, receive: Receive) -> bytes | Problem:
        limit = self._settings.body_limit_bytes
        too_large = Problem("body-too-large", f"a request may have {limit} bytes")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or len(length) > 12 or int(length) > limit:
            return too_large
        if length == "0" and "transfer-encoding" not in headers:
            return b""
        body = bytearray()
        try:
            async with asyncio.timeout(self._settings.body_limit_s):
                more = True
                while more:
                    message = await receive()
                    if message["type"] == "http.disconnect":
                        return Problem("late-body", "the connection ended before the body did")
                    body += message.get("body", b"")
                    more = message.get("more_body", False)
                    if len(body) > limit:
                        return too_large
        except TimeoutError:
            return Problem("late-body", f"the body did not arrive within {self._settings.body_limit_s:g} s")
        if body and not _is_json(headers):
            return Problem("not-json", f"the media type {headers.get('content-type', '')[:100]!r} is refused")
        return bytes(body)


def foreign(headers: Headers, settings: ServiceSettings) -> Problem | None:
    """Tell what is foreign about a request: the name by which it calls the service, or the page it comes from."""
    hosts = headers.getlist("host")
    match = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if match is None or match[1].lower().strip("[]") not in settings.names:
        return Problem("foreign-host", f"the service is not called {', '.join(hosts)[:100] or 'by no name'}")
    if not _own_page(headers, hosts[0]):
        return Problem("foreign-origin", f"requests from {headers.get('origin', 'another site')[:100]} are refused")
    return None


def _own_page(headers: Headers, host: str) -> bool:
    """Whether a request comes from no web page at all, or from one of the service."""
    if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
        return False
    try:
        pages = [urlsplit(origin) for origin in headers.getlist("origin")]
    except ValueError:
        return False
    return all(page.scheme in ("http", "https") and page.netloc == host for page in pages)


def _is_json(headers: Headers) -> bool:
    given = headers.getlist("content-type")
    if len(given) != 1:
        return False
    parsed = MailMessage()
    parsed["content-type"] = given[0]
    return (
        parsed.get_content_type() == "application/json" and str(parsed.get_param("charset", "utf-8")).lower() == "utf-8"
    )


def _again(body: bytes, receive: Receive) -> Receive:
    """Hand out a body that was read already, then what comes after it."""
    handed_out = False

    async def again() -> Message:
        nonlocal handed_out
        if handed_out:
            return await receive()
        handed_out = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


def _hardened(send: Send) -> Send:
    async def hardened(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_HEADERS]}
        await send(message)

    return hardened
