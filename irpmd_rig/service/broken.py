"""The service of a rig that could not be started: whatever is asked is answered by what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from html import escape

from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from irpmd_rig.recipes.document import Problem as DocumentProblem
from irpmd_rig.service.problems import Problem, html_page
from irpmd_rig.service.security import foreign
from irpmd_rig.service.settings import ServiceSettings

_TRY_AGAIN_S = "30"


class Broken:
    """ASGI application that answers every request with status 503 and what is wrong.

    There is nothing to control, and no store yet that would hold a token: it needs none. Foreign hosts and origins
    are refused as ever.

    Parameters
    ----------
    what
        What is wrong, in a line.
    problems
        The same with file, line and column, where a document is wrong.
    settings
        Names by which it may be called.
    """

    def __init__(self, what: str, problems: Sequence[DocumentProblem], settings: ServiceSettings) -> None:
        self._settings = settings
        self._lines = [str(problem) for problem in problems] or [what]
        extras = {"errors": [asdict(problem) for problem in problems]}
        self._problem = Problem("not-started", self._lines[0], extras, {"Retry-After": _TRY_AGAIN_S})

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] == "lifespan":
            await _live(receive, send)
        elif scope["type"] == "http":
            await self._answer(Request(scope))(scope, receive, send)

    def _answer(self, request: Request) -> Response:
        refused = foreign(request.headers, self._settings)
        if refused is not None:
            return refused.response(request.url.path)
        if "text/html" not in request.headers.get("accept", ""):
            return self._problem.response(request.url.path)
        listed = "".join(f"<li><code>{escape(line)}</code></li>" for line in self._lines)
        return html_page(
            "The rig could not be started", f"<ul>{listed}</ul><p>Correct it and start the service again.</p>", 503
        )


async def _live(receive: Receive, send: Send) -> None:
    while (await receive())["type"] != "lifespan.shutdown":
        await send({"type": "lifespan.startup.complete"})
    await send({"type": "lifespan.shutdown.complete"})
