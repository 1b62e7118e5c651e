"""One acquisition, from AcquisitionStart to AcquisitionStop: triggers, exposures, readouts."""

import logging
import queue
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition, Event, Thread
from typing import Protocol

import numpy as np

from sims.camera.faults import CameraFaults
from sims.camera.parameters import CameraSettings, FrameSettings
from sims.camera.pixels import Bytes, Image, response
from sims.camera.timing import Exposure, Schedule
from sims.clock import WorldClock

_log = logging.getLogger(__name__)

SLICE_S = 0.02
"""A wait for a moment looks this often (in the clock's seconds) whether it is still wanted."""
HANG_LOOK_S = 0.01
"""A hanging camera looks this often (in real seconds) whether it has recovered."""
FREE_RUNNING_BACKLOG = 2
"""Frames exposed ahead of their readout when free running: a slow picture slows the camera down."""

Picture = Image | Callable[[], Image]
Render = Callable[[float, float, int], Picture]


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame that has been read out, on its way to the computer."""

    frame_id: int
    start_s: float
    settings: FrameSettings
    share: float
    pack: Callable[[Bytes], None]


class Sink(Protocol):
    """Takes frames to the computer."""

    def send(self, frame: Frame, ended: Event, *, lossless: bool) -> bool:
        """Send a frame; False if it is lost. `lossless` waits for a place until `ended` is set."""
        ...


@dataclass(slots=True)
class Counters:
    """What became of frames and triggers since AcquisitionStart."""

    transferred: int = 0
    skipped: int = 0
    missed_triggers: int = 0


@dataclass(frozen=True, slots=True)
class Plan:
    """What the acquisition is started with: frames to take (None: no end), trigger kind, frames a burst."""

    frames: int | None
    triggered: bool
    burst: int


class Acquisition:
    """Exposes and reads out, each in a thread of its own, so that an exposure may overlap a readout.

    Parameters
    ----------
    plan : Plan
        Frames and trigger.
    settings : CameraSettings
        What the camera is.
    current : callable
        What a frame is taken with now.
    render : callable
        The world: see `CameraTwin`.
    clock : WorldClock
        The time that the camera lives in.
    faults : CameraFaults
        Injected faults.
    sink : callable
        Where frames go now, or None.
    """

    def __init__(
        self,
        plan: Plan,
        settings: CameraSettings,
        current: Callable[[], FrameSettings],
        render: Render,
        clock: WorldClock,
        faults: CameraFaults,
        sink: Callable[[], Sink | None],
    ):
        self.counters = Counters()
        self._plan, self._settings, self._current = plan, settings, current
        self._render, self._clock, self._faults, self._sink = render, clock, faults, sink
        self._left = plan.frames
        self._schedule = Schedule(settings.timing)
        self._accepted: deque[tuple[Exposure, FrameSettings]] = deque()
        self._changed = Condition()
        self._ended = Event()
        self._readouts: queue.Queue[tuple[int, Exposure, FrameSettings, Picture] | None] = queue.Queue(
            0 if plan.triggered else FREE_RUNNING_BACKLOG
        )
        self._threads: tuple[Thread, ...] = ()

    def start(self, previous: "Acquisition | None") -> None:
        """Begin, as soon as the `previous` acquisition's threads have ended."""

        def expose() -> None:
            if previous is not None:
                previous.join()
            self._expose()

        self._threads = (
            Thread(target=expose, name="camera exposures", daemon=True),
            Thread(target=self._read_out, name="camera readouts", daemon=True),
        )
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """Stop exposing; frames not yet delivered are dropped. Does not wait."""
        with self._changed:
            self._ended.set()
            self._changed.notify_all()

    def join(self) -> None:
        """Wait for the threads' end."""
        for thread in self._threads:
            thread.join()

    @property
    def running(self) -> bool:
        """Whether frames are still to be exposed."""
        return not self._ended.is_set() and self._left != 0

    def trigger(self, time_s: float) -> None:
        """Start a frame, or a burst, at `time_s`; what the sensor cannot do then is a missed trigger."""
        with self._changed:
            if not self.running or self._faults.hanging:
                return
            settings = self._current()
            if self._faults.take_trigger() or not self._accept(time_s, settings):
                self.counters.missed_triggers += 1
            self._changed.notify_all()

    def _accept(self, time_s: float, settings: FrameSettings) -> bool:
        exposure_s, lines = settings.exposure_us * 1e-6, settings.size_px[1]
        if not self._settings.paced:
            first: Exposure | None = Exposure(time_s, exposure_s, time_s)
        else:
            first = self._schedule.trigger(time_s, exposure_s, lines)
        if first is None:
            return False
        frames = self._plan.burst if self._left is None else min(self._left, self._plan.burst)
        self._accepted.append((first, settings))
        for _ in range(frames - 1):
            self._accepted.append((self._free_running(first.start_s, settings), settings))
        self._left = None if self._left is None else self._left - frames
        return True

    def _free_running(self, now_s: float, settings: FrameSettings) -> Exposure:
        exposure_s = settings.exposure_us * 1e-6
        if not self._settings.paced:
            return Exposure(now_s, exposure_s, now_s)
        return self._schedule.free_running(now_s, exposure_s, settings.size_px[1], settings.interval_s)

    def _next(self) -> tuple[Exposure, FrameSettings] | None:
        with self._changed:
            if self._plan.triggered:
                while not self._accepted and self.running:
                    self._changed.wait()
                return self._accepted.popleft() if self._accepted and not self._ended.is_set() else None
            if not self.running:
                return None
            self._left = None if self._left is None else self._left - 1
            settings = self._current()
            return self._free_running(self._clock.now(), settings), settings

    def _expose(self) -> None:
        frame_id = 0
        while (taken := self._next()) is not None:
            exposure, settings = taken
            if not self._wait_until(exposure.start_s) or self._hung():
                continue
            try:
                picture = self._render(exposure.start_s, settings.exposure_us, settings.pixel_format.bits)
            except Exception:
                self._lose("the world could not be rendered")
            else:
                self._hand_over((frame_id, exposure, settings, picture))
            frame_id += 1
        self._hand_over(None)

    def _wait_until(self, moment_s: float) -> bool:
        """Wait until the clock shows `moment_s`; False if the acquisition ends before."""
        while not self._ended.is_set():
            remaining_s = moment_s - self._clock.now()
            if remaining_s <= 0:
                return True
            self._clock.sleep(min(remaining_s, SLICE_S))
        return False

    def _hung(self) -> bool:
        hung = self._faults.hanging
        while self._faults.hanging and not self._ended.wait(HANG_LOOK_S):
            pass
        return hung

    def _hand_over(self, item: tuple[int, Exposure, FrameSettings, Picture] | None) -> None:
        while True:
            try:
                self._readouts.put(item, timeout=HANG_LOOK_S)
            except queue.Full:
                if self._ended.is_set() and item is not None:
                    return
            else:
                return

    def _read_out(self) -> None:
        while (item := self._readouts.get()) is not None:
            frame_id, exposure, settings, picture = item
            fault = self._faults.take_frame()
            if not self._wait_until(exposure.delivered_s + fault.late_s):
                continue
            if fault.dropped:
                self.counters.skipped += 1
                continue
            try:
                image = self._image(picture() if callable(picture) else picture, settings)
            except Exception:
                self._lose("the world could not be rendered")
                continue
            self._send(frame_id, exposure, settings, image, fault.share)

    def _image(self, image: Image, settings: FrameSettings) -> Image:
        """Cut the region out of a sensor's image and apply gain and gamma."""
        width, height = self._settings.size_px
        bits = settings.pixel_format.bits
        wanted = np.dtype(np.uint8 if bits == 8 else np.uint16)
        if image.shape != (height, width) or image.dtype != wanted:
            raise ValueError(
                f"the world gave a {image.dtype} image of shape {image.shape}; {bits} bits of this sensor are"
                f" {wanted} of shape ({height}, {width})"
            )
        (left, top), (columns, rows) = settings.offset_px, settings.size_px
        region = image[top : top + rows, left : left + columns]
        table = response(bits, settings.gain_db, settings.gamma)
        return region if table is None else table[region]

    def _send(self, frame_id: int, exposure: Exposure, settings: FrameSettings, image: Image, share: float) -> None:
        def pack(memory: Bytes) -> None:
            settings.pixel_format.pack(image, memory, settings.line_padding_bytes)

        sink = self._sink()
        lossless = self._settings.lossless or not self._settings.paced
        frame = Frame(frame_id, exposure.start_s, settings, share, pack)
        if sink is not None and sink.send(frame, self._ended, lossless=lossless):
            self.counters.transferred += 1
        else:
            self.counters.skipped += 1

    def _lose(self, reason: str) -> None:
        _log.exception("frame lost: %s", reason)
        self.counters.skipped += 1
