"""The program's side of the computing process: starts it, asks it, and replaces it whatever happens to it."""

from __future__ import annotations

import contextlib
import json
import logging
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from irpmd_rig.processing.errors import ComputingLost, FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.values import Announce, ProcessedRun, Progress
from irpmd_rig.processing.whole import withdraw_partial
from irpmd_rig.programs import module_command, module_environment
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.results import Results
from irpmd_rig.store.states import Reason

# The longest step is the calibration of the rig; several times what it takes on a slow machine.
SILENCE_S = 300.0
# The kernel ends a computing process whose step takes so long, program or no program.
HANG_S = 2 * SILENCE_S
QUIT_S = 3.0
MESSAGE_LIMIT_BYTES = 1 << 20
_ATTEMPTS = 2
_ERRORS = {error.__name__: error for error in (Refused, FramesUnusable)}
_log = logging.getLogger(__name__)


class Worker:
    """One process that computes, for as long as the program runs.

    It ends by itself when the program does, however that ends. If it ends or hangs, it is replaced. The methods may
    be called from any thread; runs are computed one after the other.

    Parameters
    ----------
    root
        Root folder of the store: where calibrations and references are.
    threads
        On which it computes.
    silence_s
        It is taken to hang if it tells nothing for so long while it computes.
    """

    def __init__(self, root: Path, *, threads: int = 2, silence_s: float = SILENCE_S) -> None:
        self._root = root
        self._threads = threads
        self.silence_s = silence_s
        self._computing = threading.Lock()
        # Guards what follows; never held while waiting for the process.
        self._state = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._requests = 0
        self._cancelled = False
        self._closed = False
        with self._state:
            self._start()

    @property
    def pid(self) -> int | None:
        """The process; None after `close`, or if it ended and nothing was asked of it since."""
        with self._state:
            return None if self._child is None else self._child.pid

    def decode(self, folder: Path, station: int) -> None:
        """Have a station decoded ahead of time, while the stage moves; returns at once.

        What goes wrong is said when the run is computed.
        """
        with contextlib.suppress(ComputingLost):
            self._send({"do": "decode", "folder": str(folder), "station": station})

    def process(self, folder: Path, announce: Announce = lambda _: None) -> ProcessedRun:
        """Compute a run's results: see `irpmd_rig.processing.process.process`.

        Parameters
        ----------
        folder
            The run's folder; nobody else writes into it meanwhile.
        announce
            Is told how far it is, from this thread; what it raises ends the computing and comes out here.

        Returns
        -------
        ProcessedRun
            All of it is on disk.

        Raises
        ------
        ProcessingError
            What was wrong with the run; `ComputingLost` if the process ended twice or hung.
        """
        with self._computing:
            try:
                return self._process_again(folder, announce)
            finally:
                with self._state:
                    self._cancelled = False

    def _process_again(self, folder: Path, announce: Announce) -> ProcessedRun:
        for attempt in range(1, _ATTEMPTS + 1):
            connection, number = self._send({"do": "process", "folder": str(folder)})
            try:
                return self._answer(connection, number, folder, announce)
            except ComputingLost:
                _withdraw_partial(folder)
                raise
            except ProcessingError:
                raise
            except EOFError:
                ended = self._bury(connection)
                _withdraw_partial(folder)
                with self._state:
                    cancelled = self._cancelled
                if cancelled:
                    raise ProcessingError(
                        "the computing was cancelled", "retry the run", reason=Reason.ABORTED_BY_USER
                    ) from None
                _log.warning("%s: the computing process ended (%s), attempt %d", folder.name, ended, attempt)
            except BaseException:
                # Whoever was told does not want to go on: nothing may write into the folder any more.
                with self._state:
                    self._kill()
                self._bury(connection)
                _withdraw_partial(folder)
                raise
        raise ComputingLost(
            f"the computing process ended {_ATTEMPTS} times ({ended})",
            "see the log; the frames are on disk: retry the run, or reconstruct its folder",
        )

    def cancel(self) -> None:
        """End what is being computed: `process` raises with the reason aborted_by_user."""
        with self._state:
            if self._computing.locked():
                self._cancelled = True
                self._kill()

    def close(self) -> None:
        """End the process; may be repeated. Results are on disk whole or not at all, so it is killed."""
        with self._state:
            self._closed = True
            self._kill()
            connection = self._connection
        if connection is not None:
            self._bury(connection)

    def _answer(self, connection: Connection, number: int, folder: Path, announce: Announce) -> ProcessedRun:
        """Wait for the answer to a request; raises EOFError if the process ends."""
        for message in self._messages(connection, number, folder):
            if "progress" in message:
                announce(Progress(**message["progress"]))
            elif "done" in message:
                done = message["done"]
                return ProcessedRun(**{**done, "files": tuple(done["files"])})
            elif "failed" in message:
                failed = message["failed"]
                kind = _ERRORS.get(failed["kind"], ProcessingError)
                raise kind(failed["what"], failed["remedy"], reason=Reason(failed["reason"]))
        raise EOFError

    def _messages(self, connection: Connection, number: int, folder: Path) -> Iterator[dict[str, Any]]:
        """Messages about one request; raises EOFError or ComputingLost."""
        while True:
            try:
                if not connection.poll(self.silence_s):
                    break
                message = json.loads(connection.recv_bytes(MESSAGE_LIMIT_BYTES))
            except (OSError, ValueError):
                raise EOFError from None
            if message.get("request") == number:
                yield message
        _log.warning("%s: the computing process hangs, it is replaced", folder.name)
        with self._state:
            self._kill()
        self._bury(connection)
        raise ComputingLost(
            f"the computing process told nothing for {self.silence_s:g} s and was replaced",
            "the frames are on disk: retry the run, or reconstruct its folder",
        )

    def _send(self, message: dict[str, Any]) -> tuple[Connection, int]:
        with self._state:
            if self._closed:
                raise ComputingLost("the computing process was closed", "start the daemon again")
            if self._child is None or self._child.poll() is not None:
                self._start()
            assert self._connection is not None
            self._requests += 1
            number, connection = self._requests, self._connection
            # A process that ended just now is noticed by whoever waits for its answer.
            with contextlib.suppress(OSError):
                connection.send_bytes(json.dumps({**message, "request": number}).encode())
            return connection, number

    def _start(self) -> None:
        if self._connection is not None:
            self._connection.close()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        command = module_command(
            "irpmd_rig.processing.worker", str(theirs.fileno()), str(self._threads), str(self._root)
        )
        with theirs:
            self._child = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                env=module_environment() | _environment(self._threads),
            )
        self._connection = Connection(ours.detach())

    def _kill(self) -> None:
        if self._child is not None:
            self._child.kill()

    def _bury(self, connection: Connection) -> str:
        """Let go of the process at the other end, which has ended or is killed; returns how it ended."""
        with self._state:
            connection.close()
            process = self._child if self._connection is connection else None
            if process is None:
                return "it was replaced"
            self._child = self._connection = None
        # It may have closed its end and hang all the same.
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(QUIT_S)
        process.kill()
        code = process.wait()
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"


def _withdraw_partial(folder: Path) -> None:
    """Delete what a computing process left that ended in the middle: half of it would pass for a result."""
    with contextlib.suppress(OSError, StoreError):
        withdraw_partial(Results(folder / "results"))


def _environment(threads: int) -> dict[str, str]:
    """No library starts more threads than it is given, and freed memory goes back to the system."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
    return dict.fromkeys(names, str(threads)) | {"MALLOC_ARENA_MAX": "2", "MALLOC_MMAP_THRESHOLD_": str(4 << 20)}
