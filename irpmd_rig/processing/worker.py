"""The process that computes: `python -m irpmd_rig.processing.worker DESCRIPTOR THREADS ROOT`.

Started by `irpmd_rig.processing.link`. It computes on its main thread; another one reads what is asked, and ends the
process as soon as the other end of the socket is closed: it never outlives its parent, not even in the middle of a
computation.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from irpmd_rig.core import decode
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.processing.link import HANG_S, MESSAGE_LIMIT_BYTES
from irpmd_rig.processing.process import Processor, reported
from irpmd_rig.processing.values import Progress
from irpmd_rig.processing.warm_up import warm_up_methods
from irpmd_rig.store.library import Library
from irpmd_rig.store.run_folder import RunFolder
from irpmd_rig.store.states import Reason
from irpmd_rig.store.store import Store

_log = logging.getLogger("irpmd_rig.processing.worker")
# A run that nothing was heard of for so long was aborted, or waits for somebody; its frames can be decoded again.
_FORGET_S = 120.0
Message = dict[str, Any]


class Computer:
    """Answers what it is asked.

    Parameters
    ----------
    root
        Root folder of the store.
    threads
        On which it computes.
    send
        Takes answers.
    """

    def __init__(self, root: Path, threads: int, send: Callable[[Message], None]) -> None:
        self._library = Library(Store(root))
        self._processor = Processor(threads)
        self._send = send
        self._folder: RunFolder | None = None

    def answer(self, message: Message) -> None:
        """Do one thing, and tell about it."""
        _alive()
        folder, request = self._opened(Path(message["folder"])), message["request"]
        if message["do"] == "decode":
            self._decode(folder, int(message["station"]))
            return

        def announce(progress: Progress) -> None:
            _alive()
            self._send({"request": request, "progress": asdict(progress)})

        try:
            done = self._processor.process(folder, self._library, announce)
            done = reported(done, folder, self._library, announce)
            self._send({"request": request, "done": asdict(done)})
        except ProcessingError as error:
            self._fail(request, type(error).__name__, error.what, error.remedy, error.reason)
        # Whatever it is: the run fails, the process goes on.
        except Exception as error:
            _log.exception("%s cannot be computed", folder.path)
            what = f"{type(error).__name__}: {error}"
            remedy = "this is a fault of the program: see its log; the frames are on disk"
            self._fail(request, "ProcessingError", what, remedy, Reason.RECONSTRUCTION_FAILED)

    def forget(self) -> None:
        """Let go of what was decoded ahead for a run that does not go on."""
        self._processor.forget()

    def _decode(self, folder: RunFolder, station: int) -> None:
        try:
            self._processor.decode(folder, self._library, station)
        except ProcessingError as error:
            _log.info("%s: station %d was not decoded ahead: %s", folder.path, station, error)
        except Exception:
            _log.exception("%s: station %d was not decoded ahead", folder.path, station)

    def _opened(self, path: Path) -> RunFolder:
        """Keep the folder that was asked for last: what it has read of `run.yaml` need not be read again."""
        if self._folder is None or self._folder.path != path:
            self._folder = RunFolder(path)
        return self._folder

    def _fail(self, request: int, kind: str, what: str, remedy: str, reason: Reason) -> None:
        failed = {"kind": kind, "what": what, "remedy": remedy, "reason": str(reason)}
        self._send({"request": request, "failed": failed})


def _alive(limit_s: float = HANG_S) -> None:
    """Put off the alarm by which the kernel ends a process that hangs, even in foreign code."""
    signal.setitimer(signal.ITIMER_REAL, limit_s)


def warm_up(threads: int) -> None:
    """Load the compiled kernels: the first measurement is as fast as any other."""
    for kind, top in ((np.uint8, 200), (np.uint16, 800)):
        columns = np.arange(64) / 64
        phase = 2 * np.pi * (np.array([64, 63, 56])[:, None, None, None] * columns + np.arange(4)[:, None, None] / 4)
        frames = (top / 2 * (1 + np.cos(np.broadcast_to(phase, (3, 4, 64, 64))))).astype(kind)
        found = decode(frames, (64, 63, 56), threads=threads)
        decode(frames, (64, 63, 56), threads=threads, out=found)
    warm_up_methods()


def _listen(connection: Connection, requests: queue.SimpleQueue[bytes]) -> None:
    while True:
        try:
            requests.put(connection.recv_bytes(MESSAGE_LIMIT_BYTES))
        except (EOFError, OSError):
            # The program has ended or closed its end: nothing here is worth finishing.
            os._exit(0)


def main() -> None:
    """Serve the socket whose descriptor is the first argument until it is closed."""
    # A terminal's interrupt is for the program, which then closes the socket.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    connection, threads, root = Connection(int(sys.argv[1])), int(sys.argv[2]), Path(sys.argv[3])
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(connection, requests), name="requests", daemon=True).start()
    cv2.setNumThreads(threads)
    computer = Computer(root, threads, lambda message: connection.send_bytes(json.dumps(message).encode()))
    warm_up(threads)
    while True:
        try:
            computer.answer(json.loads(requests.get(timeout=_FORGET_S)))
        except queue.Empty:
            computer.forget()
        _alive(0.0)
        # Figures refer to themselves in circles: their memory would stay until the next collection.
        gc.collect()


if __name__ == "__main__":
    main()
