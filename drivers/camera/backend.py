"""What the worker needs of a library that reaches cameras; it runs in the worker's process only."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.camera.ximea_nodes import Value
from drivers.values import Node

NodeKind = Literal["integer", "float", "enumeration", "boolean", "string", "command", "other"]


class NodeRefused(Exception):
    """The node map refuses: out of range, not among the entries, not writable now."""


class NodeFailed(Exception):
    """The camera did not do what a node asked of it, or did not answer."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A complete frame in a buffer of the library.

    Attributes
    ----------
    data
        The buffer; not to be read after `release`.
    release
        Gives the buffer back to the library.
    """

    data: NDArray[np.uint8]
    format_code: int
    width_px: int
    height_px: int
    padding_bytes: int
    frame_id: int
    timestamp_s: float | None
    release: Callable[[], None]


class Incomplete:
    """A frame that arrived with parts missing."""


INCOMPLETE = Incomplete()


class Nodes(Protocol):
    """A node map. Every method raises NodeFailed or NodeRefused."""

    def has(self, name: str) -> bool:
        """Whether there is such a node, available now."""

    def kind(self, name: str) -> NodeKind:
        """Tell the kind of a node."""

    def writable(self, name: str) -> bool:
        """Whether it can be written now."""

    def read(self, name: str, *, fresh: bool = False) -> Value:
        """Read a value; `fresh`: from the camera, whatever a cache holds."""

    def write(self, name: str, value: Value) -> None:
        """Write a value of the node's kind."""

    def execute(self, name: str) -> None:
        """Run a command."""

    def limits(self, name: str) -> tuple[float, float, float | None]:
        """Tell minimum, maximum and step (None: any) of a number."""

    def entries(self, name: str) -> tuple[str, ...]:
        """Tell the entries of an enumeration that are available now."""

    def all(self) -> tuple[Node, ...]:
        """Read every node."""


class Backend(Protocol):
    """One camera. Opening raises the errors of `drivers.errors`, everything else those of `Nodes`."""

    nodes: Nodes

    def open(self) -> None:
        """Find the camera and connect.

        Raises
        ------
        NotConnected
            It is not there, or somebody else's.
        ConfigurationError
            The library or the camera cannot be found by these settings.
        """

    def identity(self) -> tuple[str, str, str]:
        """Vendor, model and serial number, as listed; empty where not told."""

    def start(self) -> None:
        """Announce buffers and start the acquisition."""

    def stop(self) -> None:
        """End the acquisition; all buffers are given back."""

    def fetch(self, wait_s: float) -> Picture | Incomplete | None:
        """Return the next frame; None: none within `wait_s`."""

    def lost(self) -> int:
        """Tell how many frames the transport lost since `start`, as far as it knows."""

    def xml(self) -> bytes | None:
        """Return the camera's description file; None: it has none that can be had."""

    def close(self) -> None:
        """Disconnect; never raises."""
