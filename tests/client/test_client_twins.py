"""Both clients have the same methods, and these reach every resource of the service."""

import inspect
import re

from irpmd_rig.client import AsyncClient, Client, _calls
from irpmd_rig.service.app import PREFIX, routed

# What only a browser, a reader of documentation or a supervisor asks for.
NOT_FOR_SCRIPTS = {"/devices", "/devices/camera/live", "/openapi.json", "/problems/{slug}"}
GIVEN = {
    "recipe": "name",
    "reference": False,
    "override": False,
    "duration_s": 60.0,
    "limit": 9,
    "settings": {},
    "body": {},
}


def public(kind: type) -> dict[str, inspect.Signature]:
    methods = inspect.getmembers(kind, inspect.isfunction)
    return {name: inspect.signature(method) for name, method in methods if not name.startswith("_")}


def reached() -> set[tuple[str, str]]:
    """Method and path of everything that the client can ask for."""
    found = {("GET", _calls.events_path(run)) for run in (None, "x")}
    found |= {("GET", _calls.file_path("x", "frames/x")), ("GET", _calls.export_path("x", "x"))}
    found |= {
        ("POST", "/references/x/activate"),
        ("POST", "/devices/projector/led"),
        ("POST", "/devices/projector/park"),
    }
    found |= {("POST", f"/devices/x/{command}") for command in ("home", "zero")}
    for name, make in inspect.getmembers(_calls, inspect.isfunction):
        signature = inspect.signature(make)
        if make.__module__ == _calls.__name__ and str(signature.return_annotation).startswith("Call["):
            names = {"command": "move" if name == "stage" else "show"}
            given = {key: (GIVEN | names).get(key, "x") for key in signature.parameters}
            call = make(**given)
            found.add((call.method, call.path))
    return found


def test_both_clients_have_the_same_methods_with_the_same_arguments() -> None:
    one, other = public(Client), public(AsyncClient)
    assert one.keys() == other.keys()
    for name, signature in one.items():
        assert list(signature.parameters) == list(other[name].parameters), name
        for argument, parameter in signature.parameters.items():
            assert parameter.default == other[name].parameters[argument].default, (name, argument)


def test_every_resource_of_the_service_can_be_reached() -> None:
    asked = reached()
    for path, operations in routed().openapi()["paths"].items():
        path = path.removeprefix(PREFIX)
        pattern = re.compile(re.sub(r"\{\w+\}", "[^/]+", path))
        for method in operations:
            found = any(verb == method.upper() and pattern.fullmatch(known) for verb, known in asked)
            assert found or path in NOT_FOR_SCRIPTS or path == "/metrics", (method, path)
