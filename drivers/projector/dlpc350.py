"""The driver of TI's DLPC350 (LightCrafter 4500), by its public protocol (programmer's guide DLPU010)."""

import time
from contextlib import nullcontext
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from drivers.errors import DeviceFault, Refused, Unsupported
from drivers.projector.base import PatternProjector
from drivers.projector.dlpc350_controller import (
    FLASH_IMAGES,
    IMAGE_BITS,
    LED_CURRENT,
    LED_ENABLE,
    LED_POLARITY,
    MAIN_STATUS,
    PARK,
    PARKED,
    POWER,
    RUNNING,
    TRIGGER_OUT_1,
    TRIGGER_OUT_2,
    Dlpc350Controller,
    Programme,
)
from drivers.projector.screen import Screen, ScreenSettings
from drivers.projector.source import PatternSource, Talking, try_each
from drivers.projector.usb_link import UsbBackend
from drivers.settings import Settings
from drivers.values import (
    Led,
    PatternSequence,
    ProjectorCapabilities,
    ProjectorCondition,
    ProjectorStatus,
    SyncOutput,
)

SIZE_PX = (912, 1140)
LED_BITS = {Led.RED: 0, Led.GREEN: 1, Led.BLUE: 2}
FULL_CURRENT = 255
# Shortest exposure for 1 to 8 bits, in microseconds, and the gap of a period that is longer than its exposure.
SHORTEST_US = (235, 700, 1570, 1700, 2000, 2500, 4500, 8333)
GAP_US = 230
WAKES_WITHIN_S = 2.0
# The trigger outputs' delay is counted in steps from a middle.
DELAY_STEP_US, NO_DELAY, LATEST = 0.1072, 0xBB, 0xD5


class Dlpc350Settings(Settings):
    """How the controller is reached, and what its board is like.

    Attributes
    ----------
    led_driver_inverts
        Whether the board's LED drivers give less current for a larger value, with the polarity register at its
        power-up value. It depends on the board, and is not guessed: public programs for the LightCrafter 4500
        send 255 minus the current. Look which way the light changes between 10 and 20 %.
    backend, backend_argument
        USB library as ``"module:function"`` and the argument that it is called with; none: libusb.
    serial_number
        USB serial number; none: the first that is found.
    timeout_s
        Bound of one transfer.
    video
        If given, patterns come by the video input (912 x 1140 pixels); else they lie in the box's flash.
    """

    led_driver_inverts: bool
    backend: str | None = None
    backend_argument: str | None = None
    serial_number: str | None = None
    timeout_s: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    video: ScreenSettings | None = None

    @model_validator(mode="after")
    def _complete(self) -> "Dlpc350Settings":
        if self.video is not None and self.video.size_px != SIZE_PX:
            raise ValueError(f"the `size_px` of its video is {SIZE_PX}")
        return self


class FlashPatterns:
    """A `drivers.projector.source.PatternSource`: patterns in the flash of the box.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    controller, talking
        The box, and what holds the line to it.
    """

    size_px = SIZE_PX

    def __init__(self, device: str, controller: Dlpc350Controller, talking: Talking) -> None:
        self._device = device
        self._controller = controller
        self._talking = talking
        self._programme = Programme(device, controller, talking)
        self._images = 0
        self._sequence: PatternSequence | None = None

    def begin(self) -> None:
        """Ask how many images there are."""
        self._sequence = None
        self._images = self._controller.ask(FLASH_IMAGES)[0]

    def count(self, bits: int, /) -> int:
        """Tell how many patterns the images hold."""
        return self._images * (IMAGE_BITS // bits)

    def load(self, patterns: NDArray[np.uint8]) -> None:  # noqa: ARG002 - takes none, as a source has to
        """Refuse: the box would have to be flashed."""
        raise Unsupported(
            self._device,
            "a DLPC350 takes patterns over USB only by flashing its firmware",
            "show them by `video`, or flash them with TI's program",
        )

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Set the sequence.

        Raises
        ------
        Refused
            Times that the controller cannot keep, or too many patterns.
        """
        exposure_us = round(sequence.exposure_us)
        period_us = exposure_us if sequence.period_us is None else round(sequence.period_us)
        shortest_us = SHORTEST_US[sequence.bits - 1]
        if exposure_us < shortest_us:
            raise Refused(
                self._device,
                f"{exposure_us} us are too short for {sequence.bits} bits",
                f"give at least {shortest_us} us",
            )
        if period_us != exposure_us and period_us < exposure_us + GAP_US:
            raise Refused(
                self._device,
                f"a period of {period_us} us for an exposure of {exposure_us} us",
                f"make them equal, or the period at least {exposure_us + GAP_US} us",
            )
        self._programme.check(sequence.order, sequence.bits)
        with self._talking():
            self._controller.stop()
        self._sequence = PatternSequence(sequence.order, exposure_us, period_us, sequence.bits)
        return self._sequence

    def show(self, index: int) -> None:
        """Run one pattern over and over."""
        bits = self._sequence.bits if self._sequence else 8
        exposure_us = SHORTEST_US[bits - 1]
        self._programme.from_flash((index,), bits, exposure_us, exposure_us, repeat=True)

    def show_position(self, position: int) -> None:
        """Show the pattern at one position of the order."""
        if self._sequence is not None:
            self.show(self._sequence.order[position])

    def run(self, *, repeat: bool) -> None:
        """Run the order."""
        wanted = self._sequence
        if wanted is None:
            raise Refused(self._device, "there is no order", "set one")
        period_us = wanted.period_us or wanted.exposure_us
        times = round(wanted.exposure_us), round(period_us)
        self._programme.from_flash(wanted.order, wanted.bits, *times, repeat=repeat)

    def dark(self) -> None:
        """End the display."""
        self._controller.stop()


class Dlpc350(PatternProjector):
    """A DLPC350 (a `drivers.protocols.Projector`).

    Parameters
    ----------
    name
        Name in the rig file.
    settings
        Line, board, video.
    """

    Settings: ClassVar = Dlpc350Settings

    def __init__(self, name: str, settings: Dlpc350Settings) -> None:
        super().__init__(name)
        self._settings = settings
        self._controller = Dlpc350Controller(
            name,
            settings.serial_number,
            UsbBackend(settings.backend, settings.backend_argument),
            settings.timeout_s,
        )
        self._flash = FlashPatterns(name, self._controller, self._talking)
        self._screen = None if settings.video is None else Screen(name, settings.video, self._talking, self._gate.pause)
        self._inverted = settings.led_driver_inverts

    def capabilities(self) -> ProjectorCapabilities:
        """Tell what the projector can do."""
        return ProjectorCapabilities(
            model="DLPC350 (LightCrafter 4500)",
            size_px=self._source.size_px,
            leds=tuple(LED_BITS),
            pattern_limit=None,
            can_load=self._screen is not None,
            self_paced=self._screen is None,
            has_sync=True,
            can_park=True,
            unverified=(
                "never run on a real DLPC350",
                "which way the board's LED drivers go (led_driver_inverts): look at 10 and 20 %",
                "the time to load an image from flash is not checked: with more than two, look at the first pass",
                "the pulse of a trigger output lasts as long as its pattern; width_us is not kept",
            ),
        )

    # --- what the base asks for

    @property
    def _source(self) -> PatternSource:
        return self._screen or self._flash

    @property
    def _reached(self) -> bool:
        return self._controller.link.is_open and (self._screen is None or self._screen.is_open)

    def _reach(self) -> None:
        self._controller.open()
        self._controller.write(LED_ENABLE, b"\0")
        self._controller.stop()
        if self._controller.ask(POWER)[0] & 1:
            self._controller.write(POWER, b"\0")
            time.sleep(WAKES_WITHIN_S)
        self._controller.write(PARK, b"\0")
        polarity = self._controller.ask(LED_POLARITY)[0] & 1
        self._inverted = self._settings.led_driver_inverts != bool(polarity)
        if self._screen:
            self._screen.open()
            self._take_video()
        else:
            self._flash.begin()

    def _release(self) -> None:
        self._controller.link.close()
        if self._screen:
            self._screen.close()

    def _light_off(self) -> None:
        try_each(self._controller.recover, self._leds_off, self._source.dark)

    def _set_light(self, led: Led, intensity: float) -> None:
        if led not in LED_BITS:
            raise Unsupported(self._name, f"a LightCrafter 4500 has no {led} LED", "choose red, green or blue")
        with self._talking():
            self._leds_off()
            if intensity > 0.0:
                # Cut, not rounded: never above the limit.
                level = int(FULL_CURRENT * intensity)
                currents = [level if other is led else 0 for other in LED_BITS]
                self._controller.write(
                    LED_CURRENT, bytes(FULL_CURRENT - value if self._inverted else value for value in currents)
                )
                self._controller.write(LED_ENABLE, bytes([1 << LED_BITS[led]]))

    def _set_sync(self, sync: SyncOutput) -> None:
        if sync.output not in (1, 2):
            raise Unsupported(self._name, f"there is no sync output {sync.output}", "choose 1 or 2")
        if not sync.enabled:
            raise Unsupported(self._name, "its trigger outputs cannot be switched off", "ignore them at the camera")
        steps = NO_DELAY + round(sync.delay_us / DELAY_STEP_US)
        if not 0 <= steps <= LATEST:
            earliest, latest = -NO_DELAY * DELAY_STEP_US, (LATEST - NO_DELAY) * DELAY_STEP_US
            raise Refused(self._name, f"a delay of {sync.delay_us:g} us", f"give {earliest:.2f} to {latest:.2f} us")
        inverted = int(sync.polarity == "negative")
        with self._talking():
            self._controller.stop()
            if sync.output == 1:
                self._controller.write(TRIGGER_OUT_1, bytes([inverted, steps, NO_DELAY]))
            else:
                self._controller.write(TRIGGER_OUT_2, bytes([inverted, steps]))
            self._take_video()

    def _set_parked(self, *, parked: bool) -> None:
        with self._talking():
            self._controller.stop()
            self._controller.write(PARK, bytes([parked]))
            if not parked:
                self._take_video()

    def _check_health(self) -> None:
        with self._talking():
            faults = self._controller.faults()
            if faults:
                raise DeviceFault(self._name, f"it reports {', '.join(faults)}", "switch the projector off and on")

    def _read_status(self) -> ProjectorStatus:
        faults = self._controller.faults()
        main = self._controller.ask(MAIN_STATUS)[0]
        condition = self._condition
        if main & PARKED:
            condition = ProjectorCondition.PARKED
        elif condition is ProjectorCondition.RUNNING:
            running = self._screen.running() if self._screen else main & RUNNING
            condition = ProjectorCondition.RUNNING if running else ProjectorCondition.DARK
        led, intensity = self._light or (None, 0.0)
        return ProjectorStatus(
            ProjectorCondition.FAULT if faults else condition,
            self._shown if condition is ProjectorCondition.SHOWING else None,
            led,
            intensity,
            None,
            faults,
        )

    def _take_video(self) -> None:
        """Show the video input, where patterns come from there."""
        video = self._settings.video
        if video is not None:
            Programme(self._name, self._controller, nullcontext).from_video(int(1e6 / video.refresh_hz))

    def _leds_off(self) -> None:
        self._controller.write(LED_ENABLE, b"\0")
