"""One DLPC350 on its USB line: commands and replies, and the programme of patterns that it runs."""

import time
from contextlib import suppress

from drivers.errors import DeviceFault, GarbledReply, Refused, TimedOut
from drivers.projector.dlpc350_frames import (
    ENDPOINT_IN,
    ENDPOINT_OUT,
    PACKET_BYTES,
    PRODUCT,
    VENDOR,
    StaleReply,
    decode,
    encode,
    pattern_entry,
)
from drivers.projector.source import Talking
from drivers.projector.usb_link import UsbAddress, UsbBackend, UsbLink

POWER, PARK, GAMMA = 0x0200, 0x0609, 0x1A0E
LED_POLARITY, LED_ENABLE, LED_CURRENT = 0x1A05, 0x1A07, 0x0B01
HARDWARE_STATUS, MAIN_STATUS = 0x1A0A, 0x1A0C
VALIDATE, DISPLAY_MODE, TRIGGER_OUT_1, TRIGGER_OUT_2 = 0x1A1A, 0x1A1B, 0x1A1D, 0x1A1E
SOURCE, TRIGGER_MODE, START_STOP, TIMES, CONFIGURATION = 0x1A22, 0x1A23, 0x1A24, 0x1A29, 0x1A31
MAILBOX_PLACE, MAILBOX, MAILBOX_DATA, FLASH_IMAGES = 0x1A32, 0x1A33, 0x1A34, 0x1A42

STOP, START = b"\0", b"\2"
PATTERN_MODE = b"\1"
FROM_VIDEO, FROM_FLASH = 0, 3
BY_VIDEO, BY_ITSELF = 0, 1
CLOSED, IMAGE_TABLE, PATTERN_TABLE = b"\0", b"\1", b"\2"
ALL_LEDS = 0b111

IMAGE_BITS = 24
PATTERN_ENTRIES, IMAGE_ENTRIES = 128, 64
VALIDATED_WITHIN_S, STARTED_WITHIN_S, POLL_S = 2.0, 1.0, 0.01
PARKED, RUNNING = 0b01, 0b10
# What a validation finds; each leaves patterns that are not as asked for.
FINDINGS = (
    "exposure or period cannot be",
    "a pattern number that the image does not hold",
    "a continued trigger output or overlapping black",
    "no black before an externally triggered pattern",
    "exposure and period differ by less than 230 us",
)
# Bits of the hardware status; bit 0 is the only one that is set when all is well.
FAULTS = {2: "the mirrors' reset controller", 3: "a forced swap", 6: "an aborted sequence", 7: "the sequencer"}


class Dlpc350Controller:
    """Commands of a DLPC350; used by one thread at a time.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    serial_number
        USB serial number; None: the first that is found.
    backend
        The USB library.
    timeout_s
        Bound of one transfer.
    """

    def __init__(self, device: str, serial_number: str | None, backend: UsbBackend, timeout_s: float) -> None:
        self._device = device
        self._timeout_s = timeout_s
        address = UsbAddress(VENDOR, PRODUCT, ENDPOINT_OUT, ENDPOINT_IN, serial_number=serial_number)
        self.link = UsbLink(device, address, backend, timeout_s)
        self._sequence = 0
        self._disturbed = True

    def open(self) -> None:
        """Find and claim it."""
        self.link.open()
        self._disturbed = True

    def recover(self) -> None:
        """Clear halted endpoints and throw away late replies."""
        self.link.recover(PACKET_BYTES)
        self._disturbed = False

    def write(self, command: int, data: bytes) -> None:
        """Write, and wait for the acknowledgement; raises as `ask`."""
        self._exchange(command, data, read=False)

    def ask(self, command: int, size: int = 1) -> bytes:
        """Read at least `size` bytes.

        Raises
        ------
        Refused
            The controller refuses the command.
        TimedOut, GarbledReply, DeviceLost, DeviceFault
            No reply, or none that can be read.
        """
        data = self._exchange(command, b"", read=True)
        if len(data) < size:
            raise GarbledReply(self._device, f"{len(data)} bytes in reply to {command:04X}", "retry; look at the cable")
        return data

    def faults(self) -> tuple[str, ...]:
        """Ask what the hardware status reports."""
        status = self.ask(HARDWARE_STATUS)[0]
        found = [name for bit, name in FAULTS.items() if status >> bit & 1]
        if not status & 1:
            found.append("the initialisation")
        return tuple(found)

    def stop(self) -> None:
        """End a sequence."""
        self.write(START_STOP, STOP)

    def _exchange(self, command: int, data: bytes, *, read: bool) -> bytes:
        if self._disturbed:
            self.recover()
        self._sequence = (self._sequence + 1) % 256
        self._disturbed = True
        for packet in encode(command, self._sequence, data, read=read):
            self.link.write(packet)
        give_up_s = time.monotonic() + self._timeout_s
        while (left_s := give_up_s - time.monotonic()) > 0.0:
            packet = self.link.read(PACKET_BYTES, left_s)
            try:
                with suppress(StaleReply):
                    answer = decode(self._device, command, self._sequence, packet, read=read)
                    self._disturbed = False
                    return answer
            except Refused:
                self._disturbed = False
                raise
        raise TimedOut(self._device, "only replies to earlier messages came", "look at the projector, then retry")


class Programme:
    """A sequence of patterns as the controller's tables hold it.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    controller
        The controller.
    talking
        Holds the line to it; entered for each command anew, so that a stop need not wait for the whole programme.
    """

    def __init__(self, device: str, controller: Dlpc350Controller, talking: Talking) -> None:
        self._device = device
        self._controller = controller
        self._talking = talking

    def check(self, patterns: tuple[int, ...], bits: int) -> None:
        """Raise Refused if these patterns of the flash do not fit the tables."""
        images = self._images(patterns, bits)
        limit = PATTERN_ENTRIES // (2 if len(images) == 2 else 1)
        if len(patterns) > limit or len(images) > IMAGE_ENTRIES:
            raise Refused(
                self._device,
                f"{len(patterns)} patterns from {len(images)} images do not fit its tables",
                f"give at most {limit} patterns, and {IMAGE_ENTRIES} changes of the image",
            )

    def from_flash(
        self, patterns: tuple[int, ...], bits: int, exposure_us: int, period_us: int, *, repeat: bool
    ) -> None:
        """Run patterns that lie in flash.

        Parameters
        ----------
        patterns
            Each counts through the images: pattern `image * (24 // bits) + number`.
        bits, exposure_us, period_us
            Of each of them.
        repeat
            Over and over, instead of once.
        """
        each = IMAGE_BITS // bits
        images = self._images(patterns, bits)
        if len(images) == 2:
            # Two images are loaded beforehand, and TI's newer library swaps their table, its older one does not:
            # never send exactly two.
            patterns, images = (patterns * 2, images * 2) if repeat else (patterns, [*images, images[-1]])
        entries = b"".join(
            pattern_entry(
                pattern % each, bits, ALL_LEDS, swap=place == 0 or pattern // each != patterns[place - 1] // each
            )
            for place, pattern in enumerate(patterns)
        )
        self._set_up(FROM_FLASH, BY_ITSELF, len(patterns), len(images), exposure_us, period_us, repeat=repeat)
        self._fill(IMAGE_TABLE, bytes(images))
        self._fill(PATTERN_TABLE, entries)
        self._start(watched=repeat or len(patterns) * period_us > 1e6 * STARTED_WITHIN_S / 2)

    def from_video(self, period_us: int) -> None:
        """Show what comes by the video input, 8 bits of its green, one pattern a frame."""
        self._set_up(FROM_VIDEO, BY_VIDEO, 1, 1, period_us, period_us, repeat=True)
        self._fill(PATTERN_TABLE, pattern_entry(0, 8, ALL_LEDS, swap=True))
        self._start(watched=True)

    @staticmethod
    def _images(patterns: tuple[int, ...], bits: int) -> list[int]:
        """Return the images in the order in which they are needed."""
        each = IMAGE_BITS // bits
        images: list[int] = []
        for pattern in patterns:
            if not images or images[-1] != pattern // each:
                images.append(pattern // each)
        return images

    def _set_up(
        self, source: int, trigger: int, count: int, images: int, exposure_us: int, period_us: int, *, repeat: bool
    ) -> None:
        write = self._write
        write(START_STOP, STOP)
        write(DISPLAY_MODE, PATTERN_MODE)
        write(SOURCE, bytes([source]))
        write(CONFIGURATION, bytes([count - 1, repeat, count - 1, images - 1]))
        write(TRIGGER_MODE, bytes([trigger]))
        write(TIMES, exposure_us.to_bytes(4, "little") + period_us.to_bytes(4, "little"))

    def _fill(self, mailbox: bytes, data: bytes) -> None:
        write = self._write
        write(MAILBOX, mailbox)
        write(MAILBOX_PLACE, b"\0")
        write(MAILBOX_DATA, data)
        write(MAILBOX, CLOSED)

    def _start(self, *, watched: bool) -> None:
        self._write(VALIDATE, b"")
        give_up_s = time.monotonic() + VALIDATED_WITHIN_S
        while (found := self._ask(VALIDATE)[0]) & 0x80:
            if time.monotonic() > give_up_s:
                raise TimedOut(self._device, "the sequence is not validated in time", "switch the projector off and on")
            time.sleep(POLL_S)
        if found:
            what = "; ".join(text for bit, text in enumerate(FINDINGS) if found >> bit & 1)
            raise Refused(self._device, f"the controller finds: {what or hex(found)}", "give other times or patterns")
        self._write(START_STOP, START)
        give_up_s = time.monotonic() + STARTED_WITHIN_S
        again = True
        while watched and not self._ask(MAIN_STATUS)[0] & RUNNING:
            if time.monotonic() > give_up_s:
                raise DeviceFault(self._device, "the sequence does not start", "switch the projector off and on")
            if again:
                # Coming from its video mode it needs to be told twice (so does pycrafter4500).
                self._write(START_STOP, START)
                again = False
            time.sleep(POLL_S)

    def _write(self, command: int, data: bytes) -> None:
        with self._talking():
            self._controller.write(command, data)

    def _ask(self, command: int) -> bytes:
        with self._talking():
            return self._controller.ask(command)
