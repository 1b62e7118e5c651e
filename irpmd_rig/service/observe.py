"""Counts, times and logs every answer."""

from __future__ import annotations

import logging
import re
import time

import structlog
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from irpmd_rig.service.metrics import Figures

_RUN = re.compile(r"/runs/(\d{8}-\d{6}-[0-9a-f]{6})")
_METHODS = frozenset({"GET", "POST", "PUT", "DELETE", "PATCH", "HEAD", "OPTIONS"})
_log = logging.getLogger("irpmd_rig.service")


class Observe:
    """ASGI middleware around everything else; what it writes down holds no header and no query.

    Parameters
    ----------
    app
        What is observed.
    figures
        Where answers are counted.
    """

    def __init__(self, app: ASGIApp, figures: Figures) -> None:
        self._app = app
        self._figures = figures

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and take note of its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began_s = time.perf_counter()
        status, took_s = 0, 0.0

        async def noted(message: Message) -> None:
            nonlocal status, took_s
            if message["type"] == "http.response.start":
                status, took_s = message["status"], time.perf_counter() - began_s
            await send(message)

        found = _RUN.search(scope["path"])
        bound = {"run_id": found[1]} if found else {}
        with structlog.contextvars.bound_contextvars(**bound):
            try:
                await self._app(scope, receive, noted)
            finally:
                self._note(scope, status, took_s)

    def _note(self, scope: Scope, status: int, took_s: float) -> None:
        method = scope["method"] if scope["method"] in _METHODS else "other"
        # Addresses are endless, operations are not; named as in the OpenAPI document.
        operation = getattr(scope.get("route"), "name", "none")
        self._figures.requests.labels(method, operation, str(status)).inc()
        self._figures.seconds.labels(method, operation).observe(took_s)
        level = logging.DEBUG if method == "GET" and status < 400 else logging.INFO
        client = scope.get("client")
        told = {
            "method": method,
            "path": scope["path"],
            "status": status,
            "milliseconds": round(1e3 * took_s, 2),
            "client": client[0] if client else None,
        }
        _log.log(level, "request", extra=told)
