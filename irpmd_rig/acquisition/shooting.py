"""Frames in step with the projector: bursts on its clock, or pattern by pattern.

A burst runs on the projector's clock, each pattern's sync pulse triggering the camera. Only the count ties its
frames to its patterns, and a trigger that the camera missed leaves no gap in the camera's count. So when anything
is wrong with a burst, all of it is taken again. With a software trigger every frame is taken while its own pattern
is on display, so a frame alone is taken again; the camera is armed anew first, so that a late frame cannot be
taken for the next one.
"""

from __future__ import annotations

import logging
import statistics
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import Literal, TypeVar

from drivers.protocols import (
    CameraCapabilities,
    CameraSettings,
    Frame,
    FramesLost,
    IncompleteFrame,
    InstrumentError,
    PatternSequence,
    TimedOut,
    Trigger,
)
from irpmd_rig.acquisition.captured import BurstTrigger, Cancelled, CaptureSettings, Instruments
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.exposure import START_US
from irpmd_rig.acquisition.patterns import PatternDeck, choose_timing, held_timing, longest_exposure_us

_log = logging.getLogger(__name__)

# How often a wait for a frame looks whether it is still wanted, and whether the camera is still there.
SLICE_S = 0.25
# Times between frames of a burst, in units of their median, beyond which a trigger was missed or one too many.
_EVEN = (0.5, 1.5)

Put = Callable[[int, Frame], Frame]
Result = TypeVar("Result")


class _Missing(Exception):
    """A frame did not come as it should."""

    def __init__(self, kind: Literal["lost", "incomplete", "late"], error: InstrumentError) -> None:
        super().__init__(str(error))
        self.kind = kind
        self.error = error


class Shooter:
    """Camera and projector together; knows what they are set to, and sets only what changes.

    Parameters
    ----------
    rig
        Opened instruments.
    trigger
        How patterns and frames are kept in step.
    settings
        Light, pixel format, bounds.
    cancelled
        Looked at between frames and while waiting.

    Attributes
    ----------
    exposure_us
        Of the next frames.
    faults
        How often frames were lost, incomplete or late.
    """

    def __init__(
        self, rig: Instruments, trigger: BurstTrigger, settings: CaptureSettings, cancelled: threading.Event
    ) -> None:
        self._rig = rig
        self._trigger: BurstTrigger = trigger
        self._settings = settings
        self._cancelled = cancelled
        self.exposure_us = START_US
        self.faults: Counter[str] = Counter()
        self._deck: PatternDeck | None = None
        self._configured: CameraSettings | None = None
        self._camera_can: CameraCapabilities | None = None
        self._ordered: PatternSequence | None = None
        self._lit: bool | None = None
        # Frames of a burst that the camera is armed for already.
        self._armed: int | None = None

    def look(self) -> None:
        """Raise Cancelled if it was."""
        if self._cancelled.is_set():
            raise Cancelled

    def distrust(self) -> None:
        """Set light and order anew before the next burst: its frames were not what they should be."""
        self._lit = self._ordered = None

    def exposure_range_us(self, *, lit: bool) -> tuple[float, float]:
        """Shortest and longest exposure, of frames that see the projector (`lit`) or do not."""
        self.deck()
        assert self._camera_can is not None
        low_us, high_us = self._camera_can.exposure_range_us or (1.0, 1e6)
        if lit and self._trigger == "hardware":
            longest_us = longest_exposure_us(self._rig.projector.capabilities(), self._settings.led)
            high_us = max(low_us, min(high_us, longest_us))
        return low_us, high_us

    def deck(self) -> PatternDeck:
        """Patterns of the projector; instruments that were left doing something are brought to rest first."""
        self.look()
        if self._deck is None:
            with self._at_rest_after_error():
                self._check_abilities()
                self._rig.camera.stop()
                self._rig.projector.stop()
                if self._trigger == "hardware":
                    self._rig.projector.configure_sync(self._settings.sync)
                self._deck = PatternDeck(self._rig.projector, self._settings.levels)
        return self._deck

    # --- frames

    def take(
        self, order: Callable[[PatternDeck], tuple[int, ...]], put: Put, *, again: bool = True
    ) -> tuple[list[Frame], int]:
        """Show patterns and take a frame of each.

        Parameters
        ----------
        order
            Tells the indices of the patterns.
        put
            Called with each frame and its place in the order while the next one is exposed; returns what to keep.
        again
            Whether a burst of which anything is wrong is taken again.

        Returns
        -------
        list of Frame, int
            One for each pattern, and the number of attempts that it took.

        Raises
        ------
        FramesLost
            Frames did not arrive, or only in part, in any of the attempts.
        """

        def attempt() -> list[Frame]:
            # A fault may have cost the projector its patterns: looked at each time.
            indices = self._shown(order)
            return self._burst(indices, put) if self._trigger == "hardware" else self._one_by_one(indices, put)

        return self._attempts("a burst", attempt, again=again)

    def prepare(self, order: Callable[[PatternDeck], tuple[int, ...]]) -> None:
        """Do now what `take` would do before its first pattern."""
        with self._at_rest_after_error():
            indices = self._shown(order)
            if self._trigger == "hardware":
                self._arm_burst(indices)

    def take_dark(self) -> tuple[Frame, int]:
        """One frame with the projector dark and its LED off; returns as `take` does."""
        self.deck()
        assert self._camera_can is not None
        trigger: Trigger = "software" if "software" in self._camera_can.triggers else "free"

        def attempt() -> Frame:
            self._light(on=False)
            self._configure(trigger)
            self._armed = None
            self._rig.camera.arm(1)
            if trigger == "software":
                self._rig.camera.trigger()
            return self._fetch(0)

        return self._attempts("a frame", attempt)

    def take_switched(self, order: tuple[int, int], rest_s: float, delay_s: float) -> tuple[Frame, float, int]:
        """One frame `delay_s` after the order to go from one pattern, shown for `rest_s`, to another.

        Returns it, the time that it really was (longer where the projector does not return sooner), and the number of
        attempts.
        """

        def attempt() -> tuple[Frame, float]:
            self._shown(lambda deck: deck.plain(order[0]))
            self._configure("software")
            self._ordered = None
            self._order(order)
            self._rig.camera.arm(1)
            self._armed = None
            self._rig.projector.step()
            self._pause(rest_s)
            ordered_s = time.monotonic()
            self._rig.projector.step()
            self._pause(delay_s - (time.monotonic() - ordered_s))
            after_s = time.monotonic() - ordered_s
            self._rig.camera.trigger()
            frame = self._fetch(0)
            # Past the last: dark.
            self._rig.projector.step()
            return frame, after_s

        (frame, after_s), number = self._attempts("a frame", attempt)
        return frame, after_s, number

    def _pause(self, duration_s: float) -> None:
        if duration_s > 0.0 and self._cancelled.wait(duration_s):
            self.look()

    def darken(self) -> None:
        """Show nothing, the LED off."""
        self.deck()
        with self._at_rest_after_error():
            self._light(on=False)

    def _shown(self, order: Callable[[PatternDeck], tuple[int, ...]]) -> tuple[int, ...]:
        deck = self.deck()
        self._light(on=True)
        return order(deck)

    def _arm_burst(self, order: tuple[int, ...]) -> None:
        self._configure("hardware")
        self._order(order)
        if self._armed != len(order):
            self._armed = None
            self._rig.camera.arm(len(order))
            self._armed = len(order)

    def _burst(self, order: tuple[int, ...], put: Put) -> list[Frame]:
        self._arm_burst(order)
        self._armed = None
        self._rig.projector.run_once()
        frames = [put(number, self._fetch(number)) for number in range(len(order))]
        self._check_even(frames)
        return frames

    def _one_by_one(self, order: tuple[int, ...], put: Put) -> list[Frame]:
        camera, projector = self._rig.camera, self._rig.projector
        self._configure("software")
        # Also where it is the same as before: `step` begins it again.
        self._ordered = None
        self._order(order)
        camera.arm(len(order))
        armed_at, frames = 0, []
        for number in range(len(order)):
            projector.step()
            for left in reversed(range(self._settings.retries + 1)):
                try:
                    camera.trigger()
                    frames.append(put(number, self._fetch(number - armed_at)))
                    break
                except _Missing as missing:
                    self._note(missing)
                    if not left:
                        raise _given_up("a frame", self._settings.retries + 1, missing) from missing
                    # The pattern is still on display; what comes late belongs to the old arming and is dropped.
                    camera.stop()
                    camera.arm(len(order) - number)
                    armed_at = number
        # Past the last: dark.
        projector.step()
        return frames

    def _fetch(self, index: int) -> Frame:
        end_s = time.monotonic() + self._settings.frame_timeout_s
        camera = self._rig.camera
        while True:
            self.look()
            left_s = end_s - time.monotonic()
            try:
                frame = camera.fetch(max(0.0, min(SLICE_S, left_s)))
            except TimedOut as error:
                if left_s <= SLICE_S:
                    raise _Missing("late", error) from error
            except FramesLost as error:
                raise _Missing("lost", error) from error
            except IncompleteFrame as error:
                raise _Missing("incomplete", error) from error
            else:
                if frame.index != index:
                    what = f"frame {frame.index} of the burst came in the place of frame {index}"
                    raise _Missing("lost", FramesLost(camera.name, what, "take the burst again"))
                return frame

    def _check_even(self, frames: list[Frame]) -> None:
        """Find a trigger too few or too many that the number of frames does not show."""
        times_s = [frame.timestamp_s for frame in frames if frame.timestamp_s is not None]
        if len(times_s) < max(3, len(frames)):
            return
        gaps_s = [later - earlier for earlier, later in pairwise(times_s)]
        typical_s = statistics.median(gaps_s)
        for number, gap_s in enumerate(gaps_s, 1):
            if not _EVEN[0] * typical_s <= gap_s <= _EVEN[1] * typical_s:
                what = (
                    f"frame {number} came {1e3 * gap_s:.3g} ms after the one before it, others {1e3 * typical_s:.3g} ms"
                )
                remedy = "check the trigger's cable, and the camera's shortest period"
                raise _Missing("lost", FramesLost(self._rig.camera.name, what, remedy))

    # --- again

    def _attempts(self, what: str, take: Callable[[], Result], *, again: bool = True) -> tuple[Result, int]:
        number = 1
        while True:
            try:
                with self._at_rest_after_error():
                    return take(), number
            except _Missing as missing:
                self._note(missing)
                if not again or number > self._settings.retries:
                    raise _given_up(what, number, missing) from missing
            number += 1

    def _note(self, missing: _Missing) -> None:
        self.faults[missing.kind] += 1
        _log.warning("a frame is %s: %s", missing.kind, missing.error)

    @contextmanager
    def _at_rest_after_error(self) -> Iterator[None]:
        """After any error, let nothing run on that could trigger the next burst, and trust no setting."""
        try:
            yield
        except BaseException:
            for instrument in (self._rig.projector, self._rig.camera):
                with suppress(InstrumentError):
                    instrument.stop()
            self._configured = self._ordered = self._lit = self._armed = None
            if self._deck is not None:
                self._deck.forget()
            raise

    # --- what the instruments are set to

    def _light(self, *, on: bool) -> None:
        if self._lit == on:
            return
        projector, settings = self._rig.projector, self._settings
        self._lit = None
        if not on:
            projector.stop()
        if projector.capabilities().leds:
            projector.set_led(settings.led, settings.intensity if on else 0.0)
        self._lit = on

    def _configure(self, trigger: Trigger) -> None:
        wanted = CameraSettings(exposure_us=self.exposure_us, pixel_format=self._settings.pixel_format, trigger=trigger)
        if wanted == self._configured:
            return
        camera = self._rig.camera
        self._configured = None
        if self._armed is not None:
            self._armed = None
            camera.stop()
        camera.configure(wanted)
        # The shortest period depends on the exposure.
        self._camera_can = camera.capabilities()
        self._configured = wanted

    def _order(self, order: tuple[int, ...]) -> None:
        can, led = self._rig.projector.capabilities(), self._settings.led
        if self._trigger == "hardware":
            timing = choose_timing(can, led, self.exposure_us, self._camera_period_us())
        else:
            timing = held_timing(can, led, self.exposure_us)
        wanted = PatternSequence(order, timing.exposure_us, timing.period_us, timing.bits)
        if wanted == self._ordered:
            return
        self._ordered = None
        self._rig.projector.order(wanted)
        self._ordered = wanted

    def _camera_period_us(self) -> float:
        rates = self._camera_can.frame_rate_range_hz if self._camera_can else None
        return max(self.exposure_us, 1e6 / rates[1] if rates else 0.0)

    def _check_abilities(self) -> None:
        projector, camera = self._rig.projector.capabilities(), self._rig.camera.capabilities()
        self._camera_can = camera
        if self._trigger not in camera.triggers:
            raise AcquisitionError(f"the camera has no {self._trigger} trigger", f"it has {', '.join(camera.triggers)}")
        if self._trigger == "hardware" and not (projector.self_paced and projector.has_sync):
            raise AcquisitionError(
                f"the projector ({projector.model}) gives no sync pulse to trigger the camera by",
                "set trigger: software",
            )


def _given_up(what: str, attempts: int, missing: _Missing) -> FramesLost:
    error = missing.error
    return FramesLost(error.device, f"{what} failed {attempts} times, at last: {error.what}", error.remedy)
