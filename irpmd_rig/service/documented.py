"""Which problems an operation answers with, for its OpenAPI description."""

from __future__ import annotations

from typing import Any

from irpmd_rig.service.problem_types import TYPES
from irpmd_rig.service.problems import MEDIA_TYPE

SCHEMA = "ProblemDocument"

ALWAYS = ("foreign-host", "foreign-origin", "unauthorized", "too-busy")
BODY = ("malformed-json", "late-body", "body-too-large", "not-json", "invalid")
COMMAND = (
    "lease-held", "lease-needed", "rig-busy", "stopped", "action-refused", "instrument-refused", "unsupported",
    "device-lost", "device-timeout", "device-fault", "motion-failed", "frames-lost",
)  # fmt: skip
RUN = ("no-such-run", "unreadable-run")
DISK = ("disk-full", "write-failed")

Responses = dict[int | str, dict[str, Any]]


def problems(*slugs: str) -> Responses:
    """Describe the answers that are problems, by status."""
    described: Responses = {}
    for slug in dict.fromkeys((*ALWAYS, *slugs)):
        kind = TYPES[slug]
        found = described.setdefault(
            kind.status,
            {"description": "", "content": {MEDIA_TYPE: {"schema": {"$ref": f"#/components/schemas/{SCHEMA}"}}}},
        )
        found["description"] += f"{'; ' if found['description'] else ''}{kind.title} (`{kind.slug}`)"
    return described


def binary(*media_types: str) -> Responses:
    """Describe an answer of bytes."""
    return {200: {"description": "The file", "content": {kind: {"schema": _BYTES} for kind in media_types}}}


def text(description: str, media_type: str) -> Responses:
    """Describe an answer of text."""
    return {200: {"description": description, "content": {media_type: {"schema": {"type": "string"}}}}}


_BYTES = {"type": "string", "format": "binary"}
