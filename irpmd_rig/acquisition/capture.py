"""Taking pictures with a rig: exposure, single frames, fringe sets that are checked and retaken, and moves between."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from typing import Any, Literal

from drivers.protocols import Frame, InstrumentError, Position, Stage, StageCondition
from irpmd_rig.acquisition.captured import (
    BurstTrigger,
    Cancelled,
    CapturedFrame,
    CaptureSettings,
    FrameQuality,
    FrameRole,
    FrameStack,
    FringeFrames,
    Instruments,
)
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.exposure import brightness, measure_exposure_us
from irpmd_rig.acquisition.patterns import BLACK, WHITE, Orientation, PatternDeck
from irpmd_rig.acquisition.shooting import Shooter
from irpmd_rig.core import check_frames

__all__ = [
    "Cancelled",
    "CaptureSettings",
    "CapturedFrame",
    "FrameQuality",
    "FringeFrames",
    "Instruments",
    "Photographer",
]

_log = logging.getLogger(__name__)

_WATCH_S = 0.02
# A black picture is on display by then, whatever the display.
SWITCHED_REST_S = 0.5


class Photographer:
    """Takes frames with a rig; for one thread at a time, but for `check`.

    Every operation raises `Cancelled` once it is cancelled; `InstrumentError` for an instrument that fails;
    `FramesLost` and `FrameQuality` where frames did not come out right in any of the attempts; `AcquisitionError`
    for what this rig cannot do. After an error the projector is dark and the camera is not armed.

    Parameters
    ----------
    rig
        Opened instruments.
    trigger
        ``"hardware"``: bursts on the projector's clock. ``"software"``: pattern by pattern.
    settings
        Light, pixel format, bounds.
    cancelled
        Looked at between frames and while waiting.
    """

    def __init__(
        self,
        rig: Instruments,
        trigger: BurstTrigger = "hardware",
        settings: CaptureSettings | None = None,
        cancelled: threading.Event | None = None,
    ) -> None:
        self._rig = rig
        self._settings = settings or CaptureSettings()
        self._cancelled = cancelled or threading.Event()
        self._shooter = Shooter(rig, trigger, self._settings, self._cancelled)
        self._faulty = 0

    @property
    def exposure_us(self) -> float:
        """Exposure of the next frames."""
        return self._shooter.exposure_us

    @property
    def faults(self) -> Mapping[str, int]:
        """How often frames were ``lost``, ``incomplete``, ``late`` or ``faulty`` so far, retaken ones included."""
        faults = dict(self._shooter.faults)
        return {**faults, "faulty": self._faulty} if self._faulty else faults

    # --- exposure

    def expose(self, role: FrameRole = "white", exposure_us: float | Literal["auto"] = "auto") -> float:
        """Set the exposure of later frames.

        Parameters
        ----------
        role
            What it is for: ``"plain"`` frames see no projector; all others are exposed for white.
        exposure_us
            An exposure, or ``"auto"``: the brightest parts reach 85 % of full scale.

        Returns
        -------
        float
            The exposure in microseconds, to write down.

        Raises
        ------
        AcquisitionError
            The camera or the projector's sequences do not allow it.
        FramesError
            ``"auto"`` finds no exposure: nothing is lit, or everything is too bright.
        """
        range_us = self._shooter.exposure_range_us(lit=role != "plain")
        if exposure_us == "auto":
            found_us = measure_exposure_us(
                lambda tried_us: self._trial(role, tried_us), self._shooter.exposure_us, range_us
            )
        elif range_us[0] <= exposure_us <= range_us[1]:
            found_us = float(exposure_us)
        else:
            raise AcquisitionError(
                f"an exposure of {exposure_us:g} us is out of range",
                f"give {range_us[0]:g} to {range_us[1]:g} us, which camera and projector's sequences allow",
            )
        self._shooter.exposure_us = found_us
        return found_us

    def _trial(self, role: FrameRole, exposure_us: float) -> Frame:
        self._shooter.exposure_us = exposure_us
        return (self.plain() if role == "plain" else self.white()).frame

    # --- frames

    def white(self) -> CapturedFrame:
        """One frame of the brightest picture."""
        return self._single("white", WHITE)

    def black(self) -> CapturedFrame:
        """One frame of the black picture, the LED on."""
        return self._single("black", BLACK)

    def plain(self) -> CapturedFrame:
        """One frame without the projector: dark, LED off."""
        frame, attempt = self._shooter.take_dark()
        return self._captured(frame, "plain", attempt)

    def switched(self, delay_s: float) -> CapturedFrame:
        """One frame a time after the order to go from black to white; `checks` tells the time that it really was."""
        frame, after_s, attempt = self._shooter.take_switched((BLACK, WHITE), SWITCHED_REST_S, delay_s)
        return replace(self._captured(frame, "switched", attempt), checks={"after_s": after_s})

    def series(self, counts: tuple[float, ...], steps: int, frames: int, since_s: float) -> tuple[CapturedFrame, ...]:
        """Frames of the first of some fringes, one after the other, as fast as they come.

        `checks` tells the middle of each exposure, in seconds since `since_s` of `time.monotonic`. Prepare them
        before (`prepare_series`), and nothing is in between. A burst of which frames are lost is not taken again: its
        moment is over.

        Raises
        ------
        FramesLost
            Frames did not arrive, or only in part.
        """
        order = _first_only(counts, steps, frames)
        taken, attempt = self._shooter.take(order, lambda _, frame: frame, again=False)
        half_s = 0.5e-6 * self._shooter.exposure_us
        return tuple(
            replace(self._captured(frame, "series", attempt), checks={"after_s": arrived_s - half_s - since_s})
            for frame, arrived_s in zip(taken, _arrivals_s(taken), strict=True)
        )

    def prepare_series(self, counts: tuple[float, ...], steps: int, frames: int) -> None:
        """Load, order and arm for a series."""
        self._shooter.prepare(_first_only(counts, steps, frames))

    def dark(self) -> None:
        """Show nothing, the LED off."""
        self._shooter.darken()

    def fringes(self, counts: tuple[float, ...], steps: int, orientation: Orientation = "x") -> FringeFrames:
        """Fringe sets, checked; all are taken again if the check finds anything.

        Parameters
        ----------
        counts
            Fringe count of each set.
        steps
            Phase steps of each set.
        orientation
            Along which the phase grows.

        Returns
        -------
        FringeFrames
            One frame for each step of each set, in order.

        Raises
        ------
        FrameQuality
            The last attempt was still faulty.
        """
        attempt = 1
        while True:
            taken = self.take_fringes(counts, steps, orientation, attempt=attempt)
            try:
                return self.check(taken)
            except FrameQuality as quality:
                if attempt > self._settings.retries:
                    raise
                _log.warning("fringes are taken again: %s", quality.what)
            attempt += 1

    def take_fringes(
        self, counts: tuple[float, ...], steps: int, orientation: Orientation = "x", *, attempt: int = 1
    ) -> FringeFrames:
        """Fringe sets as they come, not checked: the stage may move, or more be taken, during `check`.

        A caller that moves before the check has to take the whole station again where it fails: frames of two
        motions are never mixed. `attempt` is what the frames are marked with.
        """
        stack = FrameStack((len(counts), steps))
        frames, attempts = self._shooter.take(lambda deck: deck.fringes(counts, steps, orientation), stack.put)
        captured = tuple(
            replace(
                self._captured(frame, "fringes", attempt + attempts - 1),
                orientation=orientation,
                counts=counts,
                steps=steps,
                set=number // steps,
                step=number % steps,
            )
            for number, frame in enumerate(frames)
        )
        return FringeFrames(captured, stack.images())

    def prepare_fringes(self, counts: tuple[float, ...], steps: int, orientation: Orientation = "x") -> None:
        """Load, order and arm for the fringes that are taken next; meant for while a stage moves."""
        self._shooter.prepare(lambda deck: deck.fringes(counts, steps, orientation))

    def check(self, taken: FringeFrames) -> FringeFrames:
        """Check fringe frames for stale, blended, swapped, saturated and dim ones; may run in another thread.

        Returns
        -------
        FringeFrames
            The same frames with the figures of the check.

        Raises
        ------
        FrameQuality
            A frame is not what it should be.
        """
        full_scale_dn = 2 ** taken[0].frame.bits - 1
        report = check_frames(taken.images, taken[0].counts, saturation_dn=full_scale_dn)
        if not report.ok:
            self._faulty += 1
            self._shooter.distrust()
            raise FrameQuality(report)
        figures = {name: _plain(value) for name, value in asdict(report).items() if name != "findings"}
        return FringeFrames(tuple(replace(frame, checks=figures) for frame in taken), taken.images)

    def _single(self, role: Literal["white", "black"], index: int) -> CapturedFrame:
        frames, attempt = self._shooter.take(lambda deck: deck.plain(index), lambda _, frame: frame)
        return self._captured(frames[0], role, attempt)

    def _captured(self, frame: Frame, role: FrameRole, attempt: int) -> CapturedFrame:
        lit = role != "plain"
        return CapturedFrame(
            frame=frame,
            role=role,
            exposure_us=self._shooter.exposure_us if frame.exposure_us is None else frame.exposure_us,
            led=self._settings.led if lit else None,
            intensity=self._settings.intensity if lit else 0.0,
            attempt=attempt,
            checks={} if role == "fringes" else {"brightness": brightness(frame)},
        )

    # --- motion

    def begin_move(self, stage: str, position_mm: float) -> None:
        """Start a move, without waiting; nothing is sent if the stage stands there or is on its way.

        Raises
        ------
        AcquisitionError
            There is no such stage.
        """
        self._shooter.look()
        axis = self._stage(stage)
        state = axis.state()
        if state.target_mm != position_mm or state.condition not in (StageCondition.READY, StageCondition.MOVING):
            axis.move_to(position_mm)

    def move(self, stage: str, position_mm: float) -> Position:
        """Move a stage and wait until it has settled; once cancelled it is stopped, where it can be.

        Returns
        -------
        Position
            Where it stands, and whether that was measured.
        """
        axis = self._stage(stage)
        self._shooter.look()
        with _ended_by(self._cancelled, axis.stop):
            self.begin_move(stage, position_mm)
            try:
                return axis.wait()
            except InstrumentError:
                self._shooter.look()
                raise

    def _stage(self, name: str) -> Stage:
        if name not in self._rig.stages:
            raise AcquisitionError(f"the rig has no {name}", f"it has {', '.join(self._rig.stages) or 'no stage'}")
        return self._rig.stages[name]


def _first_only(counts: tuple[float, ...], steps: int, frames: int) -> Callable[[PatternDeck], tuple[int, ...]]:
    return lambda deck: deck.fringes(counts, steps, "x")[:1] * frames


def _arrivals_s(frames: list[Frame]) -> list[float]:
    """When frames were there, on the computer's clock but spaced by the camera's: the computer may be late."""
    received_s, stamped_s = [frame.received_s for frame in frames], [frame.timestamp_s for frame in frames]
    known_s = [stamp_s for stamp_s in stamped_s if stamp_s is not None]
    if len(known_s) < len(frames):
        return received_s
    offset_s = min(late_s - stamp_s for late_s, stamp_s in zip(received_s, known_s, strict=True))
    return [stamp_s + offset_s for stamp_s in known_s]


def _plain(value: Any) -> Any:
    """A figure as JSON knows it: what is not known is None, not NaN."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


@contextmanager
def _ended_by(cancelled: threading.Event, stop: Callable[[], object]) -> Iterator[None]:
    """Stop what goes on inside once it is cancelled."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_WATCH_S):
            if cancelled.is_set():
                with suppress(InstrumentError):
                    stop()
                return

    watcher = threading.Thread(target=watch, name="cancel watch")
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
