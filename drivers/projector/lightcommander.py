"""The driver of a DLP LightCommander (DLP5500 mirrors, DLPC200 controller), by the operations of TI's API."""

from pathlib import Path
from typing import ClassVar

from drivers.errors import DeviceFault, Refused
from drivers.projector.base import PatternProjector
from drivers.projector.lightcommander_settings import LightCommanderSettings
from drivers.projector.pattern_memory import LIMIT, PatternMemory
from drivers.projector.screen import Screen
from drivers.projector.sequence_file import read_sequence_file
from drivers.projector.source import PatternSource, try_each
from drivers.projector.ti_api import LED_NUMBERS, SOURCE_DVI, SOURCE_SL_AUTO, Result, Transport, Value
from drivers.projector.ti_library import LibraryTransport
from drivers.projector.ti_usb import UsbTransport
from drivers.projector.usb_link import UsbBackend
from drivers.projector.usb_profile import load_profile
from drivers.values import Led, ProjectorCapabilities, ProjectorCondition, ProjectorStatus, SyncOutput

LONGEST_SYNC_US = 0xFFFFFFFF

UNVERIFIED = (
    "never run on a real LightCommander: check LED, sync and pattern order with a photodiode first",
    "bit plane i*bits + k holds the bits of value 2^k of image i: show a grey ramp and look",
    "several bits are shown plane by plane: compare a grey ramp at a camera exposure of all and of half the pattern's",
    "LED intensity above 60 % damages the box (erratum E0031): measure the current at 10 % first",
    "infrared is off-label for the mirrors (420 to 700 nm)",
)


class LightCommander(PatternProjector):
    """A LightCommander (a `drivers.protocols.Projector`).

    Parameters
    ----------
    name
        Name in the rig file.
    settings
        Transport, sequences, video.

    Raises
    ------
    ConfigurationError
        The profile may not be used, or a sequence file cannot be read.
    """

    Settings: ClassVar = LightCommanderSettings

    def __init__(self, name: str, settings: LightCommanderSettings) -> None:
        super().__init__(name)
        self._firmware = "not asked yet"
        self._transport, self._title = make_transport(name, settings)
        self._memory: PatternMemory | None = None
        self._screen: Screen | None = None
        if settings.video is not None:
            self._screen = Screen(name, settings.video, self._talking, self._gate.pause)
            self._patterns: PatternSource = self._screen
        else:
            files = tuple(
                read_sequence_file(name, Path(path), infrared_name=settings.infrared_name)
                for path in settings.sequences
            )
            self._patterns = self._memory = PatternMemory(name, self._ask, self._gate.pause, files)

    def capabilities(self) -> ProjectorCapabilities:
        """Tell what the projector can do."""
        return ProjectorCapabilities(
            model=f"DLP LightCommander (firmware {self._firmware}) over {self._title}",
            size_px=self._source.size_px,
            leds=tuple(Led),
            pattern_limit=None if self._screen else LIMIT,
            can_load=True,
            self_paced=self._screen is None,
            has_sync=self._screen is None,
            can_park=True,
            unverified=UNVERIFIED,
            timings=self._memory.timings if self._memory else None,
        )

    # --- what the base asks for

    @property
    def _source(self) -> PatternSource:
        return self._patterns

    @property
    def _reached(self) -> bool:
        return self._transport.is_open and (self._screen is None or self._screen.is_open)

    def _reach(self) -> None:
        if self._memory:
            self._memory.forget()
        self._transport.open()
        self._command("DLP_Status_CommunicationStatus")
        self._firmware = str(self._command("DLP_Status_GetMCUversionString"))
        self._light_off()
        self._command("DLP_Display_UnparkDMD")
        self._command("DLP_Source_SetDataSource", source=SOURCE_DVI if self._screen else SOURCE_SL_AUTO)
        if self._screen:
            self._screen.open()

    def _release(self) -> None:
        self._transport.close()
        if self._screen:
            self._screen.close()

    def _light_off(self) -> None:
        # One call turns all LEDs off; only a box that took it is told about each of them.
        try_each(self._transport.recover, self._led_driver_off, self._display_off)
        for number in LED_NUMBERS.values():
            self._command("DLP_LED_SetLEDEnable", led=number, on=0)

    def _led_driver_off(self) -> None:
        self._command("DLP_LED_LEDdriverEnable", on=0)

    def _display_off(self) -> None:
        if self._screen is None or not self._screen.is_open:
            self._command("DLP_Display_DisplayStop")
        else:
            self._screen.dark()

    def _set_light(self, led: Led, intensity: float) -> None:
        if self._memory and intensity > 0.0:
            if not self._memory.lights(led):
                # It would take another sequence.
                self._refuse_while_running()
            changed = self._memory.light(led)
        else:
            changed = False
        for other, number in LED_NUMBERS.items():
            if other is not led or intensity == 0.0:
                self._ask("DLP_LED_SetLEDEnable", led=number, on=0)
        if intensity == 0.0:
            self._ask("DLP_LED_LEDdriverEnable", on=0)
            return
        self._ask("DLP_LED_SetLEDintensity", led=LED_NUMBERS[led], percent=100.0 * intensity)
        self._ask("DLP_LED_SetLEDEnable", led=LED_NUMBERS[led], on=1)
        self._ask("DLP_LED_LEDdriverEnable", on=1)
        if changed and self._condition is ProjectorCondition.SHOWING and self._shown is not None:
            # Another sequence ends the display.
            self._source.show(self._shown)

    def _set_sync(self, sync: SyncOutput) -> None:
        if not (0 <= sync.delay_us <= LONGEST_SYNC_US and 0 < sync.width_us <= LONGEST_SYNC_US):
            raise Refused(self._name, f"a sync pulse {sync}", "give a delay from 0 and a width from 1 us")
        if not 0 <= sync.output <= 255:
            raise Refused(self._name, f"there is no sync output {sync.output}", "see the box's documents")
        if sync.enabled:
            self._ask(
                "DLP_Sync_Configure",
                output=sync.output,
                polarity=int(sync.polarity == "positive"),
                delay_us=round(sync.delay_us),
                width_us=max(1, round(sync.width_us)),
            )
        self._ask("DLP_Sync_SetEnable", output=sync.output, on=int(sync.enabled))

    def _set_parked(self, *, parked: bool) -> None:
        self._ask("DLP_Display_ParkDMD" if parked else "DLP_Display_UnparkDMD")

    def _check_health(self) -> None:
        with self._talking():
            faults = self._faults()
            if faults:
                raise DeviceFault(self._name, f"it reports {', '.join(faults)}", "let it cool, then set the LED again")

    def _read_status(self) -> ProjectorStatus:
        faults = self._faults()
        condition = self._condition
        if self._command("DLP_Status_GetDMDparkState"):
            condition = ProjectorCondition.PARKED
        elif condition is ProjectorCondition.RUNNING:
            running = self._screen.running() if self._screen else self._command("DLP_Status_GetSeqRunState")
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

    # --- inside

    def _faults(self) -> tuple[str, ...]:
        asked = {
            "an LED driver fault": "DLP_Status_GetLEDdriverFault",
            "an LED driver that is too hot": "DLP_Status_GetOverallLEDdriverTempTimeoutState",
        }
        return tuple(fault for fault, operation in asked.items() if self._command(operation))

    def _ask(self, operation: str, **values: Value) -> Result:
        """Call the box for an operation that may be stopped."""
        with self._talking():
            return self._command(operation, **values)

    def _command(self, operation: str, **values: Value) -> Result:
        return self._transport.call(operation, **values)


def make_transport(name: str, settings: LightCommanderSettings) -> tuple[Transport, str]:
    """Return the way to the box that the settings name, and what it is called."""
    if settings.library is not None:
        return LibraryTransport(name, Path(settings.library), settings.timeout_s), "TI's library"
    profile = load_profile(settings.profile or "", device=name)
    backend = UsbBackend(settings.backend, settings.backend_argument)
    transport = UsbTransport(name, profile, settings.serial_number, backend, settings.timeout_s)
    return transport, f"USB, profile {profile.title!r} (verified: {profile.verified})"
