"""A camera over GenICam in a worker process: what both backends share, and the one through a GenTL producer."""

import itertools
import math
import threading
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, TypeVar

from drivers.camera.channel import ChannelError
from drivers.camera.link import Link
from drivers.camera.messages import capabilities_from, dump_from, settings_from, settings_message
from drivers.camera.options import CameraOptions, HarvestersSettings
from drivers.camera.session import Session, Tally
from drivers.errors import DeviceLost, GarbledReply, InstrumentError, NotConnected, Refused, TimedOut
from drivers.values import (
    CameraCapabilities,
    CameraCounters,
    CameraSettings,
    Frame,
    NodeMap,
    StopAnswer,
)

Made = TypeVar("Made")
# A worker answers `stop` between two slices of waiting; one that does not within this is killed.
STOP_LIMIT_S = 2.0


class WorkerCamera:
    """A camera whose library runs in a process of its own (a `drivers.protocols.Camera`).

    The process is replaced by the next operation after it crashed, hung or lost its camera: `configure`, `arm`,
    `capabilities`, `temperature_c` and `dump` connect again, with the settings that were in force.

    Parameters
    ----------
    name
        Name in the rig file.
    settings
        What the rig file says.
    """

    backend: ClassVar[str]

    def __init__(self, name: str, settings: CameraOptions) -> None:
        self._name = name
        self._options = settings
        self._operation = threading.Lock()
        self._state = threading.Lock()
        self._numbers = itertools.count(1)
        self._is_open = False
        self._link: Link | None = None
        self._session: Session | None = None
        self._settings: CameraSettings | None = None
        self._trigger_in_force = CameraSettings().trigger
        self._stops = 0
        self._tally = Tally()

    @property
    def name(self) -> str:
        """Name in the rig file."""
        return self._name

    @property
    def process_id(self) -> int | None:
        """The worker's process; None: there is none."""
        with self._state:
            return None if self._link is None else self._link.pid

    # ---- connection ----

    def open(self) -> None:
        """Start the worker and connect to the camera."""
        with self._operation:
            with self._state:
                if self._is_open:
                    return
                self._is_open = True
            self._tally = Tally()
            self._settings = None
            self._trigger_in_force = CameraSettings().trigger
            try:
                self._connect()
            except InstrumentError:
                self._disconnect()
                raise

    def close(self) -> None:
        """End the worker; an operation under way in another thread ends, too."""
        self._disconnect()
        # One that was connecting meanwhile has ended by now, or is about to: its process must not stay.
        with self._operation:
            self._disconnect()

    def _disconnect(self) -> None:
        """End the worker without waiting for operations."""
        with self._state:
            self._is_open = False
            link, self._link = self._link, None
        self._disarm("the camera was closed")
        if link is not None:
            link.end()

    def stop(self) -> StopAnswer:
        """End the acquisition, whatever another thread is doing."""
        self._disarm("the camera was stopped")
        with self._state:
            link = self._link
        if link is not None and link.lost is None:
            try:
                link.request("stop", min(STOP_LIMIT_S, self._options.answer_timeout_s))
            except InstrumentError:
                # Not obeyed, or gone: without its process nobody takes frames from the camera.
                link.end()
        return StopAnswer(stopped=True)

    # ---- operations ----

    def capabilities(self) -> CameraCapabilities:
        """Tell what the camera can do."""
        return self._understood(capabilities_from, self._ask("capabilities"))

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings; returns what is in force."""
        with self._operation:
            session = self._armed()
            if session is not None and not session.over:
                raise Refused(self._name, "frames are being taken", "stop first")
            return self._configure(self._connected(), settings)

    def arm(self, frames: int | None = None) -> None:
        """Start the acquisition; triggers are answered from now on."""
        if frames is not None and frames < 1:
            raise Refused(self._name, f"a burst of {frames} frames is refused", "give 1 or more, or None")
        with self._operation:
            link = self._connected()
            with self._state:
                stops = self._stops
            self._disarm("the camera was armed again", is_stop=False)
            session = Session(self._name, next(self._numbers), frames, self._trigger_in_force, self._tally)
            link.arm(session, frames, self._options.answer_timeout_s)
            with self._state:
                if stops == self._stops and self._is_open:
                    self._session = session
                    return
            link.drop(session)
            raise Refused(self._name, "the camera was stopped while it was being armed", "arm it again")

    def trigger(self) -> None:
        """Start one exposure."""
        session, link = self._armed(), self._link
        if session is None or link is None or session.complete:
            raise self._not_armed()
        if session.trigger != "software":
            raise Refused(
                self._name, f"the trigger is {session.trigger!r}", "configure the camera for a software trigger"
            )
        link.request("trigger", self._options.answer_timeout_s)

    def fetch(self, timeout_s: float) -> Frame:
        """Return the next frame of the burst."""
        if not 0 <= timeout_s < math.inf:
            raise Refused(self._name, f"a time-out of {timeout_s} s is refused", "give seconds, 0 or more")
        session, link = self._armed(), self._link
        if session is None or link is None:
            raise self._not_armed()
        frame = session.next(min(timeout_s, threading.TIMEOUT_MAX))
        if frame is None:
            # No trigger, a frame lost on its way, or no camera: the camera tells.
            link.request("probe", self._options.answer_timeout_s)
            frame = session.next(0)
        if frame is None:
            raise TimedOut(
                self._name,
                f"no frame came within {timeout_s:g} s, and the camera answers",
                "check that it was triggered: cable, line, source and exposure time",
            )
        return frame

    def frames(self, timeout_s: float) -> Iterator[Frame]:
        """Yield the frames of the burst that are left."""
        session = self._armed()
        if session is None:
            raise self._not_armed()
        while not session.complete:
            yield self.fetch(timeout_s)

    def temperature_c(self) -> float:
        """Temperature in degrees Celsius."""
        return self._understood(float, self._ask("temperature"))

    def counters(self) -> CameraCounters:
        """Tell the count of frames since `open`."""
        tally = self._tally
        return CameraCounters(tally.delivered, tally.incomplete, tally.lost)

    def dump(self) -> NodeMap:
        """Read the whole node map."""
        return self._understood(dump_from, self._ask("dump"))

    # ---- within ----

    def _ask(self, do: str) -> Any:
        with self._operation:
            return self._connected().request(do, self._options.answer_timeout_s)

    def _configure(self, link: Link, settings: CameraSettings) -> CameraSettings:
        answer = link.request("configure", self._options.answer_timeout_s, settings=settings_message(settings))
        in_force = self._understood(settings_from, answer)
        self._settings = settings
        self._trigger_in_force = in_force.trigger
        return in_force

    def _connected(self) -> Link:
        """Return a worker that has its camera, a new one if need be."""
        with self._state:
            if not self._is_open:
                raise NotConnected(self._name, "the camera is not open", "open it first")
            link = self._link
        if link is not None and link.lost is None:
            return link
        if link is not None:
            link.end()
        try:
            link = self._connect()
            if self._settings is not None:
                self._configure(link, self._settings)
        except NotConnected as error:
            raise DeviceLost(self._name, f"the camera has not come back: {error.what}", error.remedy) from None
        return link

    def _connect(self) -> Link:
        try:
            link = Link(self._name)
        except OSError as error:
            raise NotConnected(
                self._name, f"the camera's process cannot be started: {error}", "check memory and limits of processes"
            ) from None
        with self._state:
            if self._is_open:
                self._link = link
            wanted = self._is_open
        try:
            if not wanted:
                raise NotConnected(self._name, "the camera was closed", "open it")
            options = self._options.model_dump()
            link.request("open", self._options.open_timeout_s, device=self._name, backend=self.backend, options=options)
        except InstrumentError as error:
            link.end()
            if isinstance(error, DeviceLost):
                raise NotConnected(error.device, error.what, error.remedy) from None
            raise
        return link

    def _armed(self) -> Session | None:
        with self._state:
            return self._session

    def _not_armed(self) -> InstrumentError:
        with self._state:
            if not self._is_open:
                return NotConnected(self._name, "the camera is not open", "open it first")
        return Refused(self._name, "the camera is not armed", "arm it first")

    def _disarm(self, reason: str, *, is_stop: bool = True) -> None:
        with self._state:
            self._stops += is_stop
            session, self._session = self._session, None
            link = self._link
        if session is not None:
            if link is not None:
                link.drop(session)
            session.discard(Refused(self._name, reason, "arm it again"))

    def _understood(self, make: Callable[[Any], Made], answer: Any) -> Made:
        try:
            return make(answer)
        except (ChannelError, TypeError, ValueError) as error:
            raise GarbledReply(
                self._name, f"the camera's process answered what is not understood: {error}", "reinstall the driver"
            ) from None


class HarvestersCamera(WorkerCamera):
    """A camera through its maker's GenTL producer."""

    Settings: ClassVar = HarvestersSettings
    backend = "harvesters"
