"""The line to the process of a simulated world: one request, one reply, each a JSON object on a line."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

from irpmd_rig.acquisition.errors import SimulationError

SOCKET = "control.sock"
LIMIT_BYTES = 4 << 20


class WorldControl:
    """Asks a running world; every call opens its own connection and ends within its bound.

    Parameters
    ----------
    folder
        Folder that the world is served in.
    timeout_s
        Bound of one call.
    """

    def __init__(self, folder: Path, timeout_s: float = 10.0) -> None:
        self.folder = folder
        self._timeout_s = timeout_s

    def hello(self) -> dict[str, Any]:
        """What the world is, and how its instruments are reached; raises as `call`."""
        return self.call("hello")

    def answers(self) -> bool:
        """Whether a world is there."""
        try:
            self.hello()
        except SimulationError:
            return False
        return True

    def has_ended(self) -> bool:
        """Whether nobody listens there any more; a world that is only slow has not ended."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(self._timeout_s)
            try:
                connection.connect(str(self.folder / SOCKET))
            except OSError as error:
                return isinstance(error, ConnectionRefusedError | FileNotFoundError)
        return False

    def call(self, call: str, /, **arguments: Any) -> dict[str, Any]:
        """Ask for one thing and return the reply.

        Raises
        ------
        SimulationError
            No world answers there within the bound, what it answers is not understood, or it refuses.
        """
        try:
            line = self._exchanged(json.dumps({**arguments, "call": call}).encode() + b"\n")
        except OSError as error:
            raise SimulationError(
                f"no simulated world answers in {self.folder}: {error.strerror or error}",
                "start one with irpmd-rig sim",
            ) from None
        try:
            reply = json.loads(line)
            ok = reply["ok"]
        except (ValueError, KeyError, TypeError):
            raise SimulationError(
                f"the world in {self.folder} answers what is not understood: {line[:80]!r}", "start it again"
            ) from None
        if not ok:
            raise SimulationError(f"the simulated world refuses {call!r}: {reply.get('error')}", "correct the request")
        answer: dict[str, Any] = reply
        return answer

    def _exchanged(self, request: bytes) -> bytes:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(self._timeout_s)
            connection.connect(str(self.folder / SOCKET))
            connection.sendall(request)
            with connection.makefile("rb") as reader:
                line = reader.readline(LIMIT_BYTES)
        if not line.endswith(b"\n"):
            raise OSError("it closed the line before it answered")
        return line
