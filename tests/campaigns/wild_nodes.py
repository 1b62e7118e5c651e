"""A camera whose nodes answer anything."""

import random
from typing import Any

from drivers.camera.backend import NodeFailed, NodeKind, NodeRefused
from drivers.values import Node


class WildNodes:
    """A camera's nodes: of the right kinds, their values, limits and entries of no sense."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._kinds: dict[str, NodeKind] = {}

    def has(self, name: str) -> bool:
        return self._maybe(name) or self._chance.random() < 0.9

    def kind(self, name: str) -> NodeKind:
        if name not in self._kinds:
            self._kinds[name] = self._chance.choice(KINDS)
        return self._kinds[name]

    def writable(self, name: str) -> bool:
        return self._maybe(name) or self._chance.random() < 0.9

    def read(self, name: str, *, fresh: bool = False) -> Any:  # noqa: ARG002
        self._maybe(name)
        return self._chance.choice(VALUES[self.kind(name)])

    def write(self, name: str, value: Any) -> None:  # noqa: ARG002
        self._maybe(name)

    def execute(self, name: str) -> None:
        self._maybe(name)

    def limits(self, name: str) -> tuple[float, float, float | None]:
        self._maybe(name)
        pick = self._chance.choice
        return float(pick(VALUES["float"])), float(pick(VALUES["float"])), pick([None, 0.0, 1.0, -1.0])

    def entries(self, name: str) -> tuple[str, ...]:
        self._maybe(name)
        return tuple(self._chance.sample(VALUES["enumeration"], self._chance.randint(0, 6)))

    def all(self) -> tuple[Node, ...]:
        return ()

    def _maybe(self, name: str) -> bool:
        fate = self._chance.random()
        if fate < 0.02:
            raise NodeFailed(f"{name}: no answer")
        if fate < 0.04:
            raise NodeRefused(f"{name}: not now")
        return False


KINDS: tuple[NodeKind, ...] = ("integer", "float", "enumeration", "boolean", "string")
VALUES: dict[str, list[Any]] = {
    "integer": [0, 1, -1, 320, 2**63 - 1, -(2**63)],
    "float": [0.0, 1.0, -1.0, 1e-300, 1e300, float("nan"), float("inf"), -float("inf")],
    "enumeration": ["Off", "On", "Mono8", "Mono10p", "Software", "Line0", "FrameStart", "RisingEdge", "", "?"],
    "boolean": [True, False],
    "string": ["", "XM-0001", "é" * 40, "0"],
}
