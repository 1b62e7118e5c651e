"""A process of a driver's own, for a library that may hang or end its process: it can be killed."""

import contextlib
import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    InstrumentError,
    NotConnected,
    Refused,
    TimedOut,
    Unsupported,
)
from drivers.projector.messages import receive, send

START_LIMIT_S = 20.0
END_LIMIT_S = 2.0
# Where this package was imported from, so that the process finds it whatever its working directory.
HERE = str(Path(__file__).parents[2])

_KINDS: dict[str, type[InstrumentError]] = {
    kind.__name__: kind for kind in (ConfigurationError, DeviceFault, NotConnected, Refused, Unsupported)
}


class Child:
    """One process, started as a module of this package, that answers calls; used by one thread at a time.

    It has a session of its own and ends when this end of its socket is closed, so that it never outlives
    the driver's process; what its libraries complain about goes where this process's complaints go.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    module
        What it runs: `main` of this module gets the number of its socket and the options.
    options
        What it is told, as JSON.

    Raises
    ------
    NotConnected
        The process cannot be started.
    """

    def __init__(self, device: str, module: str, options: dict[str, Any]) -> None:
        self._device = device
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", module, str(theirs.fileno()), json.dumps(options)],
                    pass_fds=(theirs.fileno(),),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    start_new_session=True,
                    env=os.environ | {"PYTHONPATH": os.pathsep.join([HERE, *filter(None, [os.getenv("PYTHONPATH")])])},
                )
            except OSError as error:
                ours.close()
                what = f"its process cannot be started: {error}"
                raise NotConnected(device, what, "check memory and limits of processes") from None
        self._connection = ours

    def greet(self) -> dict[str, Any]:
        """Wait until it has begun, and return what it says of itself; any error ends it."""
        try:
            self._connection.settimeout(START_LIMIT_S)
            return self._answer("starting")
        except BaseException:
            self.end()
            raise

    def call(self, call: str, data: bytes = b"", *, timeout_s: float, **values: Any) -> dict[str, Any]:
        """Call it; an answer that does not come in time ends it.

        Raises
        ------
        TimedOut
            No answer within `timeout_s`; the process was killed.
        DeviceLost
            It has ended.
        InstrumentError
            What it says went wrong.
        """
        self._connection.settimeout(timeout_s)
        try:
            send(self._connection, {"call": call} | values, data)
        except TimeoutError:
            raise self._silent(call) from None
        except OSError:
            raise self._gone() from None
        return self._answer(call)

    def end(self) -> None:
        """End the process and wait for it; never raises, may be repeated."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._connection.close()

    def _answer(self, call: str) -> dict[str, Any]:
        try:
            answer, _ = receive(self._connection)
        except TimeoutError:
            raise self._silent(call) from None
        except OSError:
            raise self._gone() from None
        if "error" in answer:
            raise _KINDS[answer["error"]](self._device, answer["what"], answer["remedy"])
        return answer

    def _silent(self, call: str) -> TimedOut:
        # Whatever it is doing, its next answer would be taken for that of the next call.
        self._process.kill()
        self._process.wait()
        what = f"{call} did not end within {self._connection.gettimeout():.3g} s"
        return TimedOut(self._device, what, "look at the projector, then retry")

    def _gone(self) -> DeviceLost:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_LIMIT_S)
        code = self._process.poll()
        return DeviceLost(
            self._device,
            f"the process that drives it has ended (code {code})",
            "see that its display or box is there, then retry",
        )
