"""Problem documents (RFC 9457) and the pages that explain them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import Any

from starlette.responses import HTMLResponse, Response

from irpmd_rig.service.problem_types import TYPES

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, slots=True)
class Problem:
    """One problem.

    Attributes
    ----------
    slug
        Which kind, of `TYPES`.
    detail
        What happened and what to do.
    extras
        More members of the document, by name.
    headers
        More headers of the answer.
    """

    slug: str
    detail: str
    extras: Mapping[str, Any] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def status(self) -> int:
        """Status of the answer."""
        return TYPES[self.slug].status

    def document(self, instance: str) -> dict[str, Any]:
        """The problem document; `instance` is the path that was asked for."""
        kind = TYPES[self.slug]
        return {
            "type": kind.uri,
            "title": kind.title,
            "status": kind.status,
            "detail": self.detail,
            "instance": instance,
            **self.extras,
        }

    def response(self, instance: str) -> Response:
        """The answer."""
        # In ASCII: what a client sent may be quoted, and need not be valid Unicode.
        content = json.dumps(self.document(instance), ensure_ascii=True, allow_nan=False, default=str)
        return Response(content.encode(), self.status, dict(self.headers), MEDIA_TYPE)


class ProblemError(Exception):
    """Raised by a handler to answer with a problem."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.detail)
        self.problem = problem


def errors_of(errors: Sequence[tuple[Sequence[str | int], str]]) -> list[dict[str, Any]]:
    """Write down what is wrong with a request: for each the place, and what it is."""
    return [{"location": [str(part) for part in place], "message": message} for place, message in errors]


def page(slug: str) -> HTMLResponse | None:
    """Return the page that explains a kind of problem; None: there is no such kind."""
    kind = TYPES.get(slug)
    if kind is None:
        return None
    paragraphs = f"<p>{escape(kind.help)}</p><p>Status {kind.status}, type <code>{kind.uri}</code>.</p>"
    return html_page(kind.title, paragraphs)


def html_page(title: str, body: str, status: int = 200) -> HTMLResponse:
    """Return a page; `body` is HTML."""
    title = escape(title)
    return HTMLResponse(
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title></head>'
        f"<body><h1>{title}</h1>{body}</body></html>\n",
        status,
        {"Content-Security-Policy": "default-src 'none'"},
    )
