"""A node map of the genicam wheel, as the worker uses it."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from genicam import genapi, gentl

from drivers.camera.backend import NodeFailed, NodeKind, NodeRefused
from drivers.camera.ximea_nodes import Value
from drivers.values import Node

_KINDS: dict[str, NodeKind] = {
    "IInteger": "integer",
    "IFloat": "float",
    "IEnumeration": "enumeration",
    "IBoolean": "boolean",
    "IString": "string",
    "ICommand": "command",
}
_REFUSALS = (
    genapi.OutOfRangeException,
    genapi.InvalidArgumentException,
    genapi.AccessException,
    genapi.LogicalErrorException,
    genapi.PropertyException,
    genapi.DynamicCastException,
)
_FRAMING = re.compile(r"^GenTL exception: | ?\(ID: -?\d+\)$")
_ABSENT = (genapi.EAccessMode.NI, genapi.EAccessMode.NA)
_WRITABLE = (genapi.EAccessMode.RW, genapi.EAccessMode.WO)
_READABLE = (genapi.EAccessMode.RW, genapi.EAccessMode.RO)


def first_line(error: Exception) -> str:
    """Say what an exception of the wheel says, without where in its sources it was raised."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return _FRAMING.sub("", lines[0].split(" : ")[0]).strip()


@contextmanager
def told_apart() -> Iterator[None]:
    """Turn the wheel's exceptions into those of `drivers.camera.backend`."""
    try:
        yield
    except _REFUSALS as error:
        raise NodeRefused(first_line(error)) from None
    except (genapi.GenericException, gentl.GenericException) as error:
        raise NodeFailed(first_line(error)) from None
    except (RuntimeError, AttributeError) as error:
        # What the wheel's wrapper raises where the library under it gave nothing to wrap.
        raise NodeFailed(first_line(error)) from None


class GenApiNodes:
    """Nodes by name.

    Parameters
    ----------
    node_map
        Of the wheel.
    """

    def __init__(self, node_map: Any) -> None:
        self._map = node_map

    def has(self, name: str) -> bool:
        """Whether there is such a node, available now."""
        with told_apart():
            return self._map.has_node(name) and self._map.get_node(name).get_access_mode() not in _ABSENT

    def kind(self, name: str) -> NodeKind:
        """Tell the kind of a node."""
        with told_apart():
            return _KINDS.get(type(self._map.get_node(name)).__name__, "other")

    def writable(self, name: str) -> bool:
        """Whether it can be written now."""
        with told_apart():
            return self._map.get_node(name).get_access_mode() in _WRITABLE

    def read(self, name: str, *, fresh: bool = False) -> Value:
        """Read a value."""
        with told_apart():
            node = self._map.get_node(name)
            if type(node).__name__ == "IEnumeration":
                # Its `value` is the symbolic name; reading past the cache yields the number only.
                return str(node.value)
            value: Value = node.get_value(False, True) if fresh else node.value
            return value

    def write(self, name: str, value: Value) -> None:
        """Write a value."""
        with told_apart():
            self._map.get_node(name).value = value

    def execute(self, name: str) -> None:
        """Run a command."""
        with told_apart():
            self._map.get_node(name).execute()

    def limits(self, name: str) -> tuple[float, float, float | None]:
        """Tell minimum, maximum and step of a number."""
        with told_apart():
            node = self._map.get_node(name)
            step = float(node.inc) if type(node).__name__ == "IInteger" else None
            return float(node.min), float(node.max), step

    def entries(self, name: str) -> tuple[str, ...]:
        """Tell the entries of an enumeration that are available now."""
        with told_apart():
            entries = self._map.get_node(name).entries
            return tuple(entry.symbolic for entry in entries if entry.get_access_mode() not in _ABSENT)

    def all(self) -> tuple[Node, ...]:
        """Read every node."""
        with told_apart():
            return tuple(_told(node) for node in self._map.nodes)


def _told(node: Any) -> Node:
    name, kind = node.node.name, type(node).__name__.removeprefix("I").lower()
    value = None
    try:
        mode = genapi.EAccessMode(node.get_access_mode())
        access = mode.name
        if mode in _READABLE and hasattr(node, "to_string"):
            value = str(node.to_string())
    except (genapi.GenericException, gentl.GenericException, RuntimeError, ValueError) as error:
        access = first_line(error)
    return Node(name, kind, access, value)
