"""The description of the service; `python -m irpmd_rig.service.openapi` writes the one that is kept beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic.json_schema import models_json_schema

from irpmd_rig.service.documented import SCHEMA
from irpmd_rig.service.models import Event, ProblemDocument
from irpmd_rig.service.problems import MEDIA_TYPE
from irpmd_rig.service.security import OPEN_PATHS

KEPT = Path(__file__).with_name("openapi.json")
_REPLACED = ("HTTPValidationError", "ValidationError")


def described(document: dict[str, Any]) -> dict[str, Any]:
    """Complete what the framework says about the routes: problems, events and the token."""
    schemas = document["components"]["schemas"]
    for name in _REPLACED:
        schemas.pop(name, None)
    _, found = models_json_schema(
        [(ProblemDocument, "validation"), (Event, "validation")], ref_template="#/components/schemas/{model}"
    )
    for name, schema in found["$defs"].items():
        schemas.setdefault(name, schema)
    document["components"]["schemas"] = dict(sorted(schemas.items()))
    document["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    for path, operations in document["paths"].items():
        for operation in operations.values():
            if path in OPEN_PATHS:
                operation["security"] = []
                operation["responses"].pop("401", None)
            _keep_problems(operation["responses"])
    return document


def _keep_problems(responses: dict[str, Any]) -> None:
    """Let an error be a problem document and nothing else, whatever the route answers otherwise."""
    for status, response in responses.items():
        if status >= "400":
            response["content"] = {MEDIA_TYPE: {"schema": {"$ref": f"#/components/schemas/{SCHEMA}"}}}


def document() -> dict[str, Any]:
    """Return the description of the service as it is."""
    from irpmd_rig.service.app import routed

    return routed().openapi()


def as_text(described_: dict[str, Any]) -> str:
    """Write a description down as it is kept."""
    return json.dumps(described_, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    KEPT.write_text(as_text(document()), encoding="utf-8")
