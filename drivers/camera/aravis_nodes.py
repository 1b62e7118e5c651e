"""A node map of Aravis, as the worker uses it."""

import re
from ctypes import byref, c_double, c_int64, c_size_t, c_uint, string_at

from drivers.camera.aravis_library import AravisLibrary
from drivers.camera.backend import NodeFailed, NodeKind, NodeRefused
from drivers.camera.ximea_nodes import Value
from drivers.values import Node

_ACCESS = {-1: "NA", 0: "RO", 1: "WO", 2: "RW"}
# The order matters: an enumeration is an integer, too.
_KINDS: tuple[NodeKind, ...] = ("enumeration", "boolean", "command", "string", "float", "integer")
_NAMED = re.compile(rb"<\w+\s[^>]*?\bName=\"(\w+)\"")


class AravisNodes:
    """Nodes by name.

    Parameters
    ----------
    library
        Aravis.
    device
        An opened device of it.
    """

    def __init__(self, library: AravisLibrary, device: int) -> None:
        self._library = library
        self._device = device
        self._types = {kind: getattr(library, f"arv_gc_{kind}_get_type")() for kind in _KINDS}

    def has(self, name: str) -> bool:
        """Whether there is such a node, available now."""
        key = name.encode()
        if not self._library.arv_device_get_feature(self._device, key):
            return False
        return bool(self._library.arv_device_is_feature_available(self._device, key))

    def kind(self, name: str) -> NodeKind:
        """Tell the kind of a node."""
        node = self._library.arv_device_get_feature(self._device, name.encode())
        if not node:
            raise NodeRefused(f"there is no node {name}")
        return next((kind for kind, number in self._types.items() if self._library.is_a(node, number)), "other")

    def writable(self, name: str) -> bool:
        """Whether it can be written now."""
        return self._access(name) in ("RW", "WO")

    def read(self, name: str, *, fresh: bool = False) -> Value:  # noqa: ARG002 - Aravis caches nothing by default
        """Read a value."""
        kind, key = self.kind(name), name.encode()
        if kind in ("enumeration", "string"):
            text = self._library.arv_device_get_string_feature_value(self._device, key)
            return str((text or b"").decode(errors="replace"))
        if kind not in ("integer", "float", "boolean"):
            raise NodeRefused(f"the node {name} has no value")
        value: Value = getattr(self._library, f"arv_device_get_{kind}_feature_value")(self._device, key)
        return value

    def write(self, name: str, value: Value) -> None:
        """Write a value."""
        kind = self.kind(name)
        low_high = self.limits(name)[:2] if kind in ("integer", "float") and not isinstance(value, str) else None
        if low_high is not None and not low_high[0] <= float(value) <= low_high[1]:
            # Aravis 0.8.26 writes what is out of range where the limits are those of another node.
            raise NodeRefused(f"it must be {low_high[0]:g} to {low_high[1]:g}")
        if kind in ("enumeration", "string"):
            self._library.arv_device_set_string_feature_value(self._device, name.encode(), str(value).encode())
        else:
            getattr(self._library, f"arv_device_set_{kind}_feature_value")(self._device, name.encode(), value)

    def execute(self, name: str) -> None:
        """Run a command."""
        self._library.arv_device_execute_command(self._device, name.encode())

    def limits(self, name: str) -> tuple[float, float, float | None]:
        """Tell minimum, maximum and step of a number."""
        key = name.encode()
        if self.kind(name) == "integer":
            low, high = c_int64(), c_int64()
            self._library.arv_device_get_integer_feature_bounds(self._device, key, byref(low), byref(high))
            step = self._library.arv_device_get_integer_feature_increment(self._device, key)
            return float(low.value), float(high.value), float(step)
        lowest, highest = c_double(), c_double()
        self._library.arv_device_get_float_feature_bounds(self._device, key, byref(lowest), byref(highest))
        return lowest.value, highest.value, None

    def entries(self, name: str) -> tuple[str, ...]:
        """Tell the entries of an enumeration that are available now."""
        count = c_uint()
        dup = self._library.arv_device_dup_available_enumeration_feature_values_as_strings
        with self._library.strings(dup(self._device, name.encode(), byref(count)), count.value) as names:
            return tuple(names)

    def xml(self) -> bytes | None:
        """Return the description file."""
        size = c_size_t()
        address = self._library.arv_device_get_genicam_xml(self._device, byref(size))
        return string_at(address, size.value) if address else None

    def all(self) -> tuple[Node, ...]:
        """Read every node that the description file names."""
        names = dict.fromkeys(name.decode() for name in _NAMED.findall(self.xml() or b""))
        return tuple(self._told(name) for name in names)

    def _access(self, name: str) -> str:
        return _ACCESS.get(self._library.arv_device_get_feature_access_mode(self._device, name.encode()), "NA")

    def _told(self, name: str) -> Node:
        kind: str = "other"
        try:
            kind = self.kind(name)
            access = self._access(name)
            value = str(self.read(name)) if access in ("RO", "RW") and kind not in ("command", "other") else None
            return Node(name, kind, access, value)
        except (NodeFailed, NodeRefused) as error:
            return Node(name, kind, str(error), None)
