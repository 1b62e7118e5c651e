"""Instruments commanded by a person, one command at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Literal

import numpy as np

from drivers.protocols import (
    CameraSettings,
    Frame,
    InstrumentError,
    Led,
    PatternSequence,
    Position,
    StopAnswer,
    TimedOut,
)
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.hands import Hands, Zeros
from irpmd_rig.acquisition.interlocks import check_move
from irpmd_rig.acquisition.patterns import held_timing
from irpmd_rig.acquisition.rig import Rig
from irpmd_rig.acquisition.safety import Safety
from irpmd_rig.core import fringe_images

FRAME_LIMIT_S = 10.0
# An order needs a time even where the pattern stays until the next command.
_HELD_US = 20_000.0

Picture = Literal["white", "black", "fringes"]


class ByHand:
    """Commands of the person who has the lease, which the caller has checked.

    Every command raises `StopLatched`, `RigBusy` and `InstrumentError`.

    Parameters
    ----------
    rig, safety, hands, zeros
        The instruments.
    look
        Called after a command that changed where a stage is.
    """

    def __init__(self, rig: Rig, safety: Safety, hands: Hands, zeros: Zeros, look: Callable[[], None]) -> None:
        self._rig = rig
        self._safety = safety
        self._hands = hands
        self._zeros = zeros
        self._look = look
        self._lock = threading.Lock()
        self._used = False
        self._settings = CameraSettings()

    def leave_safe(self) -> None:
        """Make the rig safe if commands were given since the last time and no run has it."""
        with self._lock:
            used, self._used = self._used, False
        if used and self._hands.run_id is None:
            self._safety.make_safe()

    # --- camera

    def camera_settings(self, settings: CameraSettings) -> CameraSettings:
        """Set the camera; returns what is in force. The trigger is chosen by `camera_frame`."""
        with self._command(looking=True):
            self._rig.camera.stop()
            in_force = self._rig.camera.configure(replace(settings, trigger=self._trigger()))
            self._settings = settings
            return in_force

    def camera_frame(self, timeout_s: float = FRAME_LIMIT_S) -> Frame:
        """Take one frame with the settings given last."""
        camera = self._rig.camera
        with self._command(looking=True):
            trigger = self._trigger()
            camera.stop()
            # Each time: a run may have left other settings.
            camera.configure(replace(self._settings, trigger=trigger))
            camera.arm(1)
            try:
                if trigger == "software":
                    camera.trigger()
                return camera.fetch(min(timeout_s, FRAME_LIMIT_S))
            except TimedOut:
                camera.stop()
                raise

    def _trigger(self) -> Literal["software", "free"]:
        return "software" if "software" in self._rig.camera.capabilities().triggers else "free"

    # --- projector

    def projector_show(
        self, picture: Picture, *, count: float = 64.0, step: int = 0, steps: int = 4, axis: Literal["x", "y"] = "x"
    ) -> None:
        """Show white, black, or one step of fringes, and leave it on; the LED is set apart.

        Raises
        ------
        AcquisitionError
            There is no such step.
        """
        if not 0 <= step < steps:
            raise AcquisitionError(f"step {step} of {steps} is refused", f"give 0 to {steps - 1}")
        projector = self._rig.projector
        with self._command(looking=True):
            can = projector.capabilities()
            width, height = can.size_px
            if picture == "fringes":
                image = fringe_images((count,), steps, can.size_px, axis=axis)[0, step]
            else:
                image = np.full((height, width), 255 if picture == "white" else 0, np.uint8)
            status = projector.status()
            timing = held_timing(can, status.led or self._rig.file.light.led, _HELD_US)
            projector.stop()
            projector.load(image[np.newaxis])
            projector.order(PatternSequence((0,), timing.exposure_us, timing.period_us, timing.bits))
            if status.led is not None and status.intensity:
                projector.set_led(status.led, status.intensity)
            projector.show(0)

    def projector_led(self, led: Led, intensity: float) -> None:
        """Light one LED, all others off; 0 is off."""
        with self._command(looking=True):
            self._rig.projector.set_led(led, intensity)

    def projector_park(self, *, parked: bool) -> None:
        """Park the mirrors, or make them ready again."""
        with self._command():
            if parked:
                self._rig.projector.park()
            else:
                self._rig.projector.unpark()

    # --- stages

    def stage_move(self, name: str, position_mm: float) -> Position:
        """Move a stage and wait until it stands there."""
        with self._command():
            check_move(self._rig, name, position_mm)
            stage = self._rig.stage(name)
            stage.move_to(position_mm)
            return stage.wait()

    def stage_home(self, name: str) -> Position:
        """Let a stage find its own zero."""
        with self._command():
            self._zeros.given(name)
            return self._rig.stage(name).home()

    def stage_zero(self, name: str, position_mm: float, confirmed_by: str) -> Position:
        """Call the place where a stage stands `position_mm`, on the word of a person."""
        with self._command():
            self._zeros.given(name)
            return self._rig.stage(name).zero(position_mm, confirmed_by=confirmed_by)

    def stage_stop(self, name: str) -> StopAnswer:
        """Stop a stage, whatever has it."""
        try:
            return self._rig.stage(name).stop()
        finally:
            self._look()

    # --- inside

    @contextmanager
    def _command(self, *, looking: bool = False) -> Iterator[None]:
        self._safety.check()
        with self._hands.of_person(looking=looking):
            self._safety.check()
            with self._lock:
                self._used = True
            try:
                yield
            except InstrumentError as error:
                self._rig.note(error)
                raise
            finally:
                if not looking:
                    self._look()
