"""A simulated DLP LightCommander on USB.

THE WIRE FORMAT IS INVENTED, vendor and product id included: what the real box speaks is not public. It is
written down in `lightcommander_wire.md`, for whoever writes a profile for the simulated box. The operations,
their arguments and the pattern memory (960 planes of 98304 bytes, rows in order, x = 0 in bit 0) are those of
TI's public header; rates and load time are the documented ones.
"""

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from sims.clock import WorldClock
from sims.projector.bitplanes import PLANE_BYTES, PLANES
from sims.projector.lightcommander_box import DATA_SOURCES, LightCommanderBox, Refusal, VideoSource
from sims.projector.lightcommander_frames import Request, RequestReader, Status, reply_frame
from sims.projector.player import Projection, SyncOutput
from sims.projector.sequence_file import LEDS, batch_steps
from sims.projector.usb_device import Endpoint, Identity, UsbDevice, UsbFaults

OUT, IN = 0x02, 0x86
VENDOR, PRODUCT = 0xFFF0, 0x51AC
FORGETS_AFTER_S = 1.0
OUTPUTS = 3

Handler = Callable[..., bytes | None]


@dataclass(frozen=True, slots=True)
class _Operation:
    """How the bytes of a request become arguments (None: as they are) and what is done with them."""

    layout: struct.Struct | None
    handler: Handler


class LightCommanderFaults:
    """Faults of the box, switchable from any thread while it runs; `usb` holds those of its line."""

    def __init__(self, box: LightCommanderBox, usb: UsbFaults) -> None:
        self._box = box
        self.usb = usb

    @property
    def led(self) -> str | None:
        """The LED that is broken: it stays dark, and the driver reports a fault. Set None to mend it."""
        return self._box.broken_led

    @led.setter
    def led(self, led: str | None) -> None:
        if led is not None and led not in LEDS:
            raise ValueError(f"no LED is called {led!r}: one of {', '.join(LEDS)}")
        self._box.broken_led = led
        self._box.update_light()

    def overheat(self) -> None:
        """Let the LED driver get too hot now: it switches off."""
        self._box.overheat()

    def miss_sync(self, edges: int = 1) -> None:
        """Swallow the next sync edges."""
        self._box.player.miss_sync(edges)


class LightCommander(Projection, UsbDevice):
    """The box: requests on one bulk endpoint, replies on the other.

    Parameters
    ----------
    clock
        The clock of the world.
    video
        What arrives at the video input: grey values (768, 1024), or None for no signal.
    serial_number
        Its USB serial number.
    usb_bytes_per_s
        How fast the USB line takes data, in the world's time.

    Attributes
    ----------
    faults
        What can be made to go wrong.
    player
        What is shown at any time.
    """

    def __init__(
        self,
        clock: WorldClock,
        *,
        video: VideoSource | None = None,
        serial_number: str = "SIM-LC-1",
        usb_bytes_per_s: float = 30e6,
    ) -> None:
        endpoints = (Endpoint(OUT, 2, 512), Endpoint(IN, 2, 512))
        name = "SIMULATED LightCommander (invented wire format)"
        super().__init__(Identity(VENDOR, PRODUCT, "simulated", name, serial_number, 0xFF, endpoints))
        self._clock = clock
        self._usb_bytes_per_s = usb_bytes_per_s
        self._box = LightCommanderBox(clock, OUTPUTS, video)
        self.player = self._box.player
        self.faults = LightCommanderFaults(self._box, self.usb_faults)
        self._reader = RequestReader()
        self._last_byte_s = time.monotonic()
        self._operations = self._make_operations()

    @property
    def parked(self) -> bool:
        """Whether its mirrors are parked."""
        return self._box.parked

    def external_trigger(self, time_s: float, *, rising: bool = True) -> None:
        """Give the box an edge at its trigger input."""
        self._box.external_trigger(time_s, rising=rising)

    # --- the USB side

    def power_up(self) -> None:
        """Forget a request that was begun over the old connection."""
        self._reader.forget()

    def take(self, endpoint: int, data: bytes) -> None:
        """Take the bytes of one transfer, in the time that the line needs, and queue the replies."""
        if endpoint != OUT:
            return
        self._clock.sleep(len(data) / self._usb_bytes_per_s)
        now_s = time.monotonic()
        if self._reader.begun and now_s - self._last_byte_s > FORGETS_AFTER_S:
            self._reader.forget()
        self._last_byte_s = now_s
        for request in self._reader.feed(data):
            status, payload = self._obey(request)
            self.queue(IN, reply_frame(request, status, payload))

    def _obey(self, request: Request) -> tuple[Status, bytes]:
        if not request.intact:
            return Status.CHECKSUM, b""
        operation = self._operations.get(request.opcode)
        if operation is None:
            return Status.UNKNOWN, b""
        arguments: tuple[object, ...] = (request.payload,)
        if operation.layout is not None:
            if len(request.payload) != operation.layout.size:
                return Status.LENGTH, b""
            arguments = operation.layout.unpack(request.payload)
        try:
            return Status.DONE, operation.handler(*arguments) or b""
        except Refusal as refusal:
            return refusal.status, b""

    # --- the operations

    def _make_operations(self) -> dict[int, _Operation]:
        box = self._box
        table: list[tuple[int, str | None, Handler]] = [
            (0x0101, "", box.force_first),
            (0x0102, "", box.step),
            (0x0103, "", box.run_once),
            (0x0104, "", box.run_repeatedly),
            (0x0105, "", box.stop),
            (0x0106, "", box.park),
            (0x0107, "", box.unpark),
            (0x0201, None, self._download_plane),
            (0x0301, None, self._write_order),
            (0x0302, "", box.begin_lut),
            (0x0303, "", box.end_lut),
            (0x0304, "II", box.write_register),
            (0x0305, "I", lambda register: struct.pack("<I", box.registers.get(register, 0))),
            (0x0306, None, self._run_batch_file),
            (0x0401, "BB", lambda led, on: box.enable_led(_led(led), _flag(on))),
            (0x0402, "Bd", lambda led, percent: box.set_intensity(_led(led), percent)),
            (0x0403, "B", lambda led: struct.pack("<d", box.intensity_percent(_led(led)))),
            (0x0404, "B", lambda on: box.enable_driver(_flag(on))),
            (0x0501, "BBII", self._configure_sync),
            (0x0502, "BB", self._enable_sync),
            (0x0601, "B", lambda edge: box.set_trigger_edge(rising=_flag(edge))),
            (0x0602, "B", self._set_source),
        ]
        table += self._status_operations()
        return {
            opcode: _Operation(None if layout is None else struct.Struct("<" + layout), handler)
            for opcode, layout, handler in table
        }

    def _status_operations(self) -> list[tuple[int, str | None, Handler]]:
        box = self._box

        def flag(question: Callable[[], bool]) -> Handler:
            return lambda: bytes([question()])

        return [
            (0x0701, "", lambda: b""),
            (0x0702, "", lambda: b"\x01"),
            (0x0703, "", lambda: b"\x00"),
            (0x0704, "", flag(lambda: box.parked)),
            (0x0705, "", flag(lambda: box.running)),
            (0x0706, "", lambda: bytes([box.sequence.bits if box.sequence else 0])),
            (0x0707, "", lambda: struct.pack("<d", box.sequence.exposure_us if box.sequence else 0.0)),
            (0x0708, "", lambda: struct.pack("<d", 1e6 / box.sequence.period_us if box.sequence else 0.0)),
            (0x0709, "", lambda: struct.pack("<H", box.sequence.patterns if box.sequence else 0)),
            (0x070A, "", lambda: b"\x00"),
            (0x070B, "", flag(lambda: box.broken_led is not None)),
            (0x070C, "B", lambda led: bytes([_led(led) in box.lit])),
            (0x070D, "", flag(lambda: bool(box.lit))),
            (0x070E, "B", lambda led: bytes([box.too_hot and bool(_led(led))])),
            (0x070F, "", flag(lambda: box.too_hot)),
            (0x0710, "", lambda: b"SIMULATED MCU 0.0"),
            (0x0711, "", lambda: b"SIMULATED DLPC200 0.0"),
        ]

    def _download_plane(self, payload: bytes) -> None:
        if len(payload) != 2 + PLANE_BYTES:
            raise Refusal(Status.LENGTH)
        plane = int.from_bytes(payload[:2], "little")
        if plane >= PLANES:
            raise Refusal(Status.VALUE)
        self._box.planes[plane] = payload[2:]

    def _write_order(self, payload: bytes) -> None:
        if len(payload) < 3:
            raise Refusal(Status.LENGTH)
        bits, count = struct.unpack_from("<BH", payload)
        if len(payload) != 3 + 2 * count:
            raise Refusal(Status.LENGTH)
        self._box.set_order(bits, struct.unpack_from(f"<{count}H", payload, 3))

    def _run_batch_file(self, payload: bytes) -> None:
        steps = batch_steps(payload.decode("ascii", errors="replace"))
        if steps is None:
            raise Refusal(Status.VALUE)
        for step, register, value in steps:
            if step == "Begin":
                self._box.begin_lut()
            elif step == "End":
                self._box.end_lut()
            else:
                self._box.write_register(register, value)

    def _configure_sync(self, output: int, polarity: int, delay_us: int, width_us: int) -> None:
        rising = _flag(polarity)
        present = self._output(output)
        self.player.set_output(output, replace(present, rising=rising, delay_s=delay_us / 1e6, width_s=width_us / 1e6))

    def _enable_sync(self, output: int, on: int) -> None:
        enabled = _flag(on)
        self.player.set_output(output, replace(self._output(output), enabled=enabled))

    def _output(self, number: int) -> SyncOutput:
        if number >= OUTPUTS:
            raise Refusal(Status.VALUE)
        return self.player.output(number)

    def _set_source(self, source: int) -> None:
        if source >= len(DATA_SOURCES):
            raise Refusal(Status.VALUE)
        self._box.set_source(DATA_SOURCES[source])


def _flag(value: int) -> bool:
    if value not in (0, 1):
        raise Refusal(Status.VALUE)
    return value == 1


def _led(number: int) -> str:
    if number >= len(LEDS):
        raise Refusal(Status.VALUE)
    return LEDS[number]
