"""The process that holds TI's library: `python -m drivers.projector.ti_process SOCKET OPTIONS`."""

import ctypes
import socket
from typing import Any

from drivers.projector.messages import Failure, receive, run, send
from drivers.projector.ti_api import OPERATIONS, Kind

OK = 0
TEXT_BYTES = 256

_TYPES: dict[Kind, Any] = {
    "byte": ctypes.c_ubyte,
    "uint16": ctypes.c_ushort,
    "uint32": ctypes.c_uint,
    "double": ctypes.c_double,
    "enum": ctypes.c_int,
    "boolean": ctypes.c_int,
    "string": ctypes.c_char_p,
    "bytes": ctypes.c_char_p,
    "uint16s": ctypes.POINTER(ctypes.c_ushort),
}
_OUTPUT = ctypes.CFUNCTYPE(None, ctypes.c_char_p)


class Library:
    """TI's portability layer.

    Parameters
    ----------
    path
        The shared library.
    """

    def __init__(self, path: str) -> None:
        try:
            self._library = ctypes.CDLL(path)
        except OSError as error:
            what = f"TI's library cannot be loaded: {error}"
            raise Failure("ConfigurationError", what, "correct `library`") from None
        lacking = [name for name in ("InitPortabilityLayer", *OPERATIONS) if not hasattr(self._library, name)]
        if lacking:
            what = f"{path} lacks {', '.join(lacking[:4])}"
            raise Failure("ConfigurationError", what, "name TI's API library for the LightCommander in `library`")
        # Kept: the library calls it for as long as it is loaded.
        self._output = _OUTPUT(_ignore)
        if self._library.InitPortabilityLayer(ctypes.c_ubyte(0), ctypes.c_ubyte(0), self._output) != OK:
            raise Failure("NotConnected", "TI's library finds no LightCommander", "switch it on and plug it in")

    def call(self, name: str, values: dict[str, Any], data: bytes) -> int | float | str | None:
        """Call one function, and return what it gives back."""
        operation = OPERATIONS[name]
        arguments = [self._argument(kind, values.get(key), data) for key, kind in operation.parameters]
        result: Any = None
        if operation.result == "string":
            result = ctypes.create_string_buffer(TEXT_BYTES)
            arguments += [result, ctypes.c_int(TEXT_BYTES)]
        elif operation.result is not None:
            result = _TYPES[operation.result]()
            arguments.append(ctypes.byref(result))
        if getattr(self._library, name)(*arguments) != OK:
            what = f"TI's library reports an error in {name}"
            raise Failure("DeviceFault", what, "see that the box is on, then retry")
        if result is None:
            return None
        value: int | float | bytes = result.value
        return value.decode("ascii", "replace") if isinstance(value, bytes) else value

    def _argument(self, kind: Kind, value: Any, data: bytes) -> Any:
        if kind == "bytes":
            return ctypes.c_char_p(data)
        if kind == "string":
            return ctypes.c_char_p(str(value).encode())
        if kind == "uint16s":
            return (ctypes.c_ushort * len(value))(*value)
        return _TYPES[kind](value)


def _ignore(message: bytes) -> None:
    """Take a line of the library's log."""


def serve(connection: socket.socket, options: dict[str, Any]) -> None:
    """Load the library, then answer calls until the other end has gone."""
    try:
        library = Library(options["library"])
        send(connection, {})
        while True:
            head, data = receive(connection)
            try:
                send(connection, {"result": library.call(head["call"], head["values"], data)})
            except Failure as failure:
                send(connection, failure.message)
    except Failure as failure:
        send(connection, failure.message)


if __name__ == "__main__":
    run(serve)
