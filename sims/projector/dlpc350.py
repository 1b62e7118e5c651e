"""A simulated TI DLPC350 (LightCrafter 4500) on USB, by its public protocol (programmer's guide DLPU010).

HID-style, 0451:6401, interrupt endpoints 0x01 and 0x81, packets of 64 bytes. A message is `flags sequence
lengthL lengthH CMD3 CMD2 data...` with the length of command and data, continued in further packets. Flag bit
7 reads, bit 6 asks for a reply, bit 5 in a reply is a refusal. A reply is `flags sequence lengthL lengthH
data...`.

Not modelled: variable exposure, trigger inputs' delays, TRIG_OUT_2, the bootloader (flashing images):
refused. Assumed where the guide is not explicit: settings of the pattern mode are refused while a sequence
runs, and so is a start without a validation that found exposure, period and pattern numbers right.
"""

import struct
import threading
from collections.abc import Callable, Sequence

from sims.clock import WorldClock
from sims.projector.dlpc350_patterns import RgbImage
from sims.projector.dlpc350_sequencer import Refused, Sequencer
from sims.projector.player import Projection, SyncOutput
from sims.projector.usb_device import Endpoint, Identity, UsbDevice, UsbFaults

VENDOR, PRODUCT = 0x0451, 0x6401
OUT, IN, PACKET_BYTES = 0x01, 0x81, 64
READ, REPLY, REFUSED = 0x80, 0x40, 0x20
HEAD = struct.Struct("<BBH")
LARGEST_MESSAGE = 512

# Registers that only keep what is written: (CMD2 CMD3): (bytes, value after power-up).
KEPT = {
    0x1008: b"\0",
    0x1009: b"\0",
    0x1203: b"\0",
    0x1A00: b"\0",
    0x1A02: b"\0",
    0x1A03: b"\0",
    0x1A04: b"\0",
    0x1A0E: b"\0",
    0x1A1E: b"\0\xbb",
    0x1A1F: b"\xbb\xbb",
    0x1A20: b"\xbb\xbb",
    0x1A21: b"\xbb\xbb",
    0x1A35: b"\0\0\0\0",
    0x1A36: b"\0",
    0x1A37: b"\0",
    0x100A: b"\0",
}

Handler = tuple[Callable[[], bytes] | None, Callable[[bytes], None] | None]


class Dlpc350Faults:
    """Faults of the controller, switchable from any thread while it runs; `usb` holds those of its line."""

    def __init__(self, sequencer: Sequencer, usb: UsbFaults) -> None:
        self._sequencer = sequencer
        self.usb = usb
        self._lock = threading.Lock()
        self._refusals = 0

    def refuse_next(self, commands: int = 1) -> None:
        """Refuse the next commands."""
        with self._lock:
            self._refusals += commands

    def abort_sequence(self) -> None:
        """Let the sequencer abort: it stops and says so in the hardware status."""
        self._sequencer.abort()

    def miss_sync(self, edges: int = 1) -> None:
        """Swallow the next edges of the trigger output."""
        self._sequencer.player.miss_sync(edges)

    def take_refusal(self) -> bool:
        """Whether the command that comes now is refused."""
        with self._lock:
            self._refusals, refused = max(0, self._refusals - 1), self._refusals > 0
            return refused


class Dlpc350(Projection, UsbDevice):
    """The controller; the images that it shows are (1140, 912).

    Parameters
    ----------
    clock
        The clock of the world.
    video
        What arrives at the video input: colours (1140, 912, 3), or None for no signal.
    flash
        The images in its flash memory, each (1140, 912, 3).
    serial_number
        Its USB serial number.
    kernel_driver
        Whether the operating system's HID driver holds the interface until it is detached, as on Linux.

    Attributes
    ----------
    faults
        What can be made to go wrong.
    player
        What is shown at any time; its one sync output is TRIG_OUT_1.
    """

    def __init__(
        self,
        clock: WorldClock,
        *,
        video: Callable[[], RgbImage | None] | None = None,
        flash: Sequence[RgbImage] = (),
        serial_number: str = "SIM-LCR4500-1",
        kernel_driver: bool = False,
    ) -> None:
        identity = Identity(
            VENDOR,
            PRODUCT,
            "Texas Instruments",
            "DLPC350",
            serial_number,
            0x03,
            (Endpoint(OUT, 3, PACKET_BYTES, 1), Endpoint(IN, 3, PACKET_BYTES, 1)),
            speed=2,
        )
        super().__init__(identity, kernel_driver=kernel_driver)
        self._clock = clock
        self._sequencer = Sequencer(clock, video or (lambda: None), flash)
        self.player = self._sequencer.player
        self.faults = Dlpc350Faults(self._sequencer, self.usb_faults)
        self._registers = dict(KEPT)
        self._pending = b""
        self._commands = self._make_commands()

    def external_trigger(self, time_s: float, *, rising: bool = True) -> None:
        """Give the controller an edge at TRIG_IN_1."""
        self._sequencer.external_trigger(time_s, rising=rising)

    # --- the USB side

    def power_up(self) -> None:
        """Forget a message that was begun over the old connection."""
        self._pending = b""

    def take(self, endpoint: int, data: bytes) -> None:
        """Take the packets of one transfer and queue the replies."""
        if endpoint != OUT:
            return
        for start in range(0, len(data), PACKET_BYTES):
            self._pending += data[start : start + PACKET_BYTES]
            if len(self._pending) < HEAD.size:
                self._pending = b""
                continue
            flags, sequence, length = HEAD.unpack_from(self._pending)
            if length > LARGEST_MESSAGE:
                self._pending = b""
                self._reply(flags | REFUSED, sequence, b"")
            elif len(self._pending) >= HEAD.size + length:
                # What follows the message in its last packet is filling.
                message, self._pending = self._pending[HEAD.size : HEAD.size + length], b""
                self._obey(flags, sequence, message)

    def _obey(self, flags: int, sequence: int, message: bytes) -> None:
        try:
            if len(message) < 2 or self.faults.take_refusal():
                raise Refused
            command = message[0] | message[1] << 8
            read, write = self._commands.get(command, (None, None))
            answer = b""
            if flags & READ:
                if read is None:
                    raise Refused
                answer = read()
            else:
                if write is None:
                    raise Refused
                write(message[2:])
        except Refused:
            flags, answer = flags | REFUSED, b""
        if flags & (READ | REPLY):
            self._reply(flags, sequence, answer)

    def _reply(self, flags: int, sequence: int, answer: bytes) -> None:
        reply = HEAD.pack(flags, sequence, len(answer)) + answer
        self.queue(IN, reply + bytes(-len(reply) % PACKET_BYTES))

    # --- the commands

    def _make_commands(self) -> dict[int, Handler]:
        seq = self._sequencer
        commands: dict[int, Handler] = {command: self._kept(command) for command in KEPT}
        commands |= {
            0x0200: (lambda: bytes([seq.standby]), _one(seq.set_standby)),
            0x0205: (lambda: bytes([0, 0, 0, 4]) * 4, None),
            0x0609: (lambda: bytes([seq.parked]), _one(seq.park)),
            0x0802: (None, lambda data: seq.reset()),  # noqa: ARG005
            0x0B01: (lambda: seq.led_currents, _sized(3, seq.set_led_currents)),
            0x1A05: (lambda: bytes([seq.currents_inverted]), _one(seq.invert_currents)),
            0x1A07: (lambda: bytes([seq.led_enables]), _one(seq.set_led_enables)),
            0x1A0A: (lambda: bytes([seq.hardware_status]), None),
            0x1A0B: (lambda: b"\x01", None),
            0x1A0C: (self._main_status, None),
            0x1A1A: (lambda: bytes([seq.validation]), lambda data: seq.validate()),  # noqa: ARG005
            0x1A1B: (lambda: bytes([seq.pattern_mode]), _one(seq.set_mode)),
            0x1A1D: (lambda: seq.trigger_out, _sized(3, self._set_trigger_out)),
            0x1A22: (lambda: bytes([seq.source]), _one(seq.set_source)),
            0x1A23: (lambda: bytes([seq.trigger_mode]), _one(seq.set_trigger_mode)),
            0x1A24: (lambda: bytes([seq.action]), _one(seq.act)),
            0x1A29: (
                lambda: struct.pack("<II", seq.exposure_us, seq.period_us),
                _sized(8, lambda data: seq.set_times(*struct.unpack("<II", data))),
            ),
            0x1A30: (lambda: bytes([seq.data_inverted]), _one(seq.invert_data)),
            0x1A31: (lambda: seq.configuration, _sized(4, seq.configure)),
            0x1A32: (lambda: bytes([seq.mailbox_address]), _one(seq.set_mailbox_address)),
            0x1A33: (lambda: bytes([seq.mailbox]), _one(seq.open_mailbox)),
            0x1A34: (seq.read_mailbox, seq.write_mailbox),
            0x1A42: (lambda: bytes([seq.flash_images]), None),
            0x1AFF: (lambda: b"SIMULATED DLPC350".ljust(32, b"\0"), None),
        }
        return commands

    def _kept(self, command: int) -> Handler:
        def write(data: bytes) -> None:
            self._registers[command] = data

        return lambda: self._registers[command], _sized(len(KEPT[command]), write)

    def _main_status(self) -> bytes:
        """Parked, sequencer running, frame buffer frozen, gamma correction on."""
        seq = self._sequencer
        flags = (seq.parked, seq.running, self._registers[0x100A] != b"\0", self._registers[0x1A0E] != b"\0")
        return bytes([sum(flag << bit for bit, flag in enumerate(flags))])

    def _set_trigger_out(self, data: bytes) -> None:
        self._sequencer.set_trigger_out(data)
        # One unit is 107.2 ns, 0xBB no delay.
        delay_s = (data[1] - 0xBB) * 107.2e-9
        self.player.set_output(0, SyncOutput(enabled=True, delay_s=delay_s, rising=not data[0] & 1))


def _sized(count: int, write: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """Refuse any other number of bytes."""

    def checked(data: bytes) -> None:
        if len(data) != count:
            raise Refused
        write(data)

    return checked


def _one(write: Callable[[int], None]) -> Callable[[bytes], None]:
    return _sized(1, lambda data: write(data[0]))
