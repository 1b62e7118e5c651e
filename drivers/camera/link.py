"""The program's side of one worker process: starts it, talks to it, and ends it whatever it does."""

import contextlib
import itertools
import logging
import os
import socket
import subprocess
import sys
import sysconfig
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.channel import Channel, ChannelError, Message
from drivers.camera.messages import error_from
from drivers.camera.ring import RingReader
from drivers.camera.session import Session, again
from drivers.errors import DeviceLost, InstrumentError, TimedOut
from drivers.values import Frame

# Between asking a worker to end and killing it, and between that and giving up on the kernel.
QUIT_S = 3.0
KILL_S = 2.0
# Where this package was imported from, so that the process finds it, and no other copy of it.
HERE = str(Path(__file__).parents[2])
_log = logging.getLogger(__name__)


def _environment() -> dict[str, str] | None:
    """Let the process find this copy of the package; an installed one it finds by itself."""
    if HERE in (sysconfig.get_path("purelib"), sysconfig.get_path("platlib")):
        return None
    return os.environ | {"PYTHONPATH": os.pathsep.join([HERE, *filter(None, [os.getenv("PYTHONPATH")])])}


class Link:
    """One worker process, and the thread that receives what it says.

    Parameters
    ----------
    device
        Name of the camera.

    Raises
    ------
    OSError
        The process cannot be started.
    """

    def __init__(self, device: str) -> None:
        self._device = device
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        command = [sys.executable, "-P", "-m", "drivers.camera.worker", str(theirs.fileno())]
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),), start_new_session=True,
                env=_environment(),
            )  # fmt: skip
        except OSError:
            ours.close()
            raise
        finally:
            theirs.close()
        self._channel = Channel(ours)
        self._sending = threading.Lock()
        self._state = threading.Condition()
        self._numbers = itertools.count(1)
        self._replies: dict[int, Message | None] = {}
        self._lost: DeviceLost | None = None
        self._session: Session | None = None
        self._ring: RingReader | None = None
        self._exposure_us: float | None = None
        self._ending = threading.Lock()
        self._ended = False
        self._receiver = threading.Thread(target=self._receive, name=f"camera {device}", daemon=True)
        self._receiver.start()

    @property
    def pid(self) -> int:
        """The worker's process."""
        return self._process.pid

    @property
    def lost(self) -> DeviceLost | None:
        """Why this worker is of no use any more; None: it is."""
        with self._state:
            return self._lost

    def request(self, do: str, timeout_s: float, **arguments: Any) -> Any:
        """Ask the worker and wait for its answer.

        Raises
        ------
        TimedOut
            No answer in time; the worker is of no use any more.
        DeviceLost
            The worker or the camera is gone.
        InstrumentError
            What the worker says.
        """
        number = next(self._numbers)
        with self._state:
            if self._lost is not None:
                raise again(self._lost)
            self._replies[number] = None
        try:
            with self._sending:
                self._channel.send({"do": do, "request": number, **arguments}, wait=False)
        except OSError:
            self._give_up("the camera's process does not listen")
        with self._state:
            self._state.wait_for(lambda: self._replies[number] is not None or self._lost is not None, timeout_s)
            reply = self._replies.pop(number)
            if reply is None and self._lost is not None:
                raise again(self._lost)
        if reply is None:
            self._give_up(f"the camera's process did not answer within {timeout_s:g} s")
            raise TimedOut(
                self._device,
                f"{do}: no answer within {timeout_s:g} s; the camera's process was given up",
                "try again: a new process is started; if that does not help, replug the camera",
            )
        if "error" in reply:
            error = self._understood(lambda: error_from(self._device, reply["error"]))
            if isinstance(error, DeviceLost):
                self._set_lost(error)
            raise error
        return reply.get("result")

    def arm(self, session: Session, frames: int | None, timeout_s: float) -> None:
        """Start an acquisition whose frames go to `session`."""
        with self._state:
            self._session = session
        self.request("arm", timeout_s, session=session.number, frames=frames)

    def drop(self, session: Session) -> None:
        """Let no more frames go to `session`."""
        with self._state:
            if self._session is session:
                self._session = None

    def end(self) -> None:
        """End the process, its thread and its descriptors; never raises, may be repeated."""
        self._set_lost(DeviceLost(self._device, "the camera's process was ended", "open the camera again"))
        with self._ending:
            if self._ended:
                return
            self._ended = True
            self._channel.shut_down()
            try:
                self._process.wait(QUIT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(KILL_S)
            self._receiver.join()
            self._channel.close()
            self._ring = None

    # ---- the receiving thread ----

    def _receive(self) -> None:
        try:
            while True:
                for message in self._channel.receive():
                    self._take(message)
        except EOFError:
            self._set_lost(
                DeviceLost(self._device, "the camera's process has ended", "try again: a new one is started")
            )
        except (ChannelError, ValueError, KeyError, TypeError, IndexError, OSError) as error:
            _log.warning("%s: the camera's process sent what is not understood: %s", self._device, error)
            self._give_up("the camera's process sent what is not understood")
        finally:
            while self._channel.descriptors:
                os.close(self._channel.descriptors.popleft())

    def _take(self, message: Message) -> None:
        if "reply" in message:
            if "ring" in message:
                self._map_ring(message["result"])
            with self._state:
                # Nobody waits for the answer any more where its number is not there.
                if message["reply"] in self._replies:
                    self._replies[message["reply"]] = message
                self._state.notify_all()
            return
        with self._state:
            session = self._session
        ours = session is not None and session.number == message["session"]
        if "slot" in message:
            ring = self._ring
            if ring is None:
                raise ChannelError("a frame before its ring")
            if session is None or not ours:
                ring.free(int(message["slot"]))
                return
            session.frame(self._frame(ring, message))
        elif session is not None and ours:
            if "lost" in message:
                session.lost(int(message["lost"]))
            elif "incomplete" in message:
                session.incomplete(int(message["incomplete"]))
            else:
                error = error_from(self._device, message["error"])
                if isinstance(error, DeviceLost):
                    self._set_lost(error)
                session.end(error)

    def _frame(self, ring: RingReader, message: Message) -> Frame:
        bits = int(message["bits"])
        kind = np.dtype(np.uint8 if bits == 8 else np.dtype("<u2"))
        return Frame(
            image=ring.take(int(message["slot"]), tuple(message["shape"]), kind),
            bits=bits,
            index=int(message["index"]),
            frame_id=int(message["frame_id"]),
            timestamp_s=message["timestamp_s"],
            received_s=float(message["received_s"]),
            exposure_us=self._exposure_us,
        )

    def _map_ring(self, told: Any) -> None:
        descriptor = self._channel.descriptors.popleft()
        try:
            self._exposure_us = told["exposure_us"]
            slots, slot_bytes = int(told["slots"]), int(told["slot_bytes"])
            if self._ring is None or not self._ring.same(descriptor):
                self._ring = RingReader(descriptor, slots, slot_bytes)
        finally:
            os.close(descriptor)

    # ---- loss ----

    def _understood(self, make: Callable[[], InstrumentError]) -> InstrumentError:
        try:
            return make()
        except ChannelError:
            self._give_up("the camera's process sent what is not understood")
            return DeviceLost(self._device, "the camera's process sent what is not understood", "try again")

    def _give_up(self, what: str) -> None:
        self._set_lost(DeviceLost(self._device, what, "try again: a new process is started"))
        # It may hang in the vendor's library, with the interpreter's lock: nothing but this reaches it.
        self._process.kill()

    def _set_lost(self, reason: DeviceLost) -> None:
        with self._state:
            if self._lost is None:
                self._lost = reason
            session, self._session = self._session, None
            self._state.notify_all()
        if session is not None:
            session.end(reason)
