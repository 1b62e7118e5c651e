"""The description of the service."""

from typing import Any

import httpx
import pytest
from service_world import API

from irpmd_rig.service.openapi import KEPT, as_text, document
from irpmd_rig.service.problem_types import TYPES

DOCUMENT = document()
OPERATIONS = [
    (f"{method.upper()} {path}", operation)
    for path, operations in DOCUMENT["paths"].items()
    for method, operation in operations.items()
]


def test_the_kept_description_is_the_present_one() -> None:
    # If it is meant to differ: python -m irpmd_rig.service.openapi
    assert KEPT.read_text(encoding="utf-8") == as_text(DOCUMENT)


def test_it_is_served_to_whoever_has_the_token(client: httpx.Client) -> None:
    assert client.get(f"{API}/openapi.json").json() == DOCUMENT


@pytest.mark.parametrize(("name", "operation"), OPERATIONS, ids=[name for name, _ in OPERATIONS])
def test_every_operation_is_described(name: str, operation: dict[str, Any]) -> None:
    assert operation["summary"]
    assert operation["description"]
    responses = operation["responses"]
    assert "403" in responses
    assert ("401" in responses) is not name.endswith("/health")
    assert not {status for status in responses if status >= "500"} - {"507"}
    for status, response in responses.items():
        assert response["description"]
        if status >= "400":
            assert list(response["content"]) == ["application/problem+json"]
    assert ("413" in responses) == ("requestBody" in operation)
    if any(one["in"] != "header" for one in operation.get("parameters", ())):
        assert responses.keys() & {"404", "422"}
    for parameter in operation.get("parameters", ()):
        assert parameter["in"] != "cookie"


def test_operations_have_names_of_their_own() -> None:
    names = [operation["operationId"] for _, operation in OPERATIONS]
    assert len(set(names)) == len(names)


def test_problem_types_are_well_formed() -> None:
    for slug, kind in TYPES.items():
        assert slug == kind.slug
        assert slug.replace("-", "").isalpha()
        assert 400 <= kind.status < 600
        assert kind.help.endswith((".", "`"))
