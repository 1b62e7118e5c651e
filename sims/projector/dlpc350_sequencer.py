"""The pattern sequencer of the simulated DLPC350: look-up tables, validation, triggers, LEDs and power."""

import math
import threading
from collections.abc import Callable, Sequence
from itertools import chain

from sims.clock import WorldClock
from sims.projector.dlpc350_patterns import (
    EXTERNAL,
    LED_BITS,
    SHORTEST_EXPOSURE_US,
    BitPattern,
    Entry,
    RgbImage,
    VideoImage,
)
from sims.projector.player import Light, Player, Programme, SyncOutput

LOAD_US = 230
LOAD_S = LOAD_US / 1e6
VALIDATION_S = 0.01
VALIDATING = 0x80
# Bits of a validation's result: times out of range, pattern numbers, trigger out over a black fill, black
# fill missing before an external trigger, and exposure neither the period nor 230 us shorter.
BAD_TIMES, BAD_NUMBERS, BAD_TRIGGER_OUT, NO_BLACK, TOO_CLOSE = 0x01, 0x02, 0x04, 0x08, 0x10
FATAL = BAD_TIMES | BAD_NUMBERS | TOO_CLOSE
INITIALISED, ABORTED = 0x01, 0x40
VSYNC_HZ = 60.0
LUT_ENTRIES, IMAGE_ENTRIES = 128, 64
IMAGE_MAILBOX, PATTERN_MAILBOX = 1, 2
STOP, PAUSE, START = 0, 1, 2
VIDEO, FLASH = 0, 3
BY_SEQUENCER = 0x08


class Refused(Exception):
    """The controller refuses a command."""


class Sequencer:
    """What the controller does, whatever it is told over."""

    def __init__(self, clock: WorldClock, video: Callable[[], RgbImage | None], flash: Sequence[RgbImage]) -> None:
        self._clock = clock
        self._lock = threading.RLock()
        self._video = video
        self._flash = tuple(flash)
        self.player = Player(clock, 1)
        self.player.set_output(0, SyncOutput(enabled=True))
        self.reset()

    def reset(self) -> None:
        """Begin as after power-up: video mode, all LEDs under the sequencer's control at half current."""
        self.standby = self.parked = False
        self.hardware_status = INITIALISED
        self.pattern_mode = False
        self.source = VIDEO
        self.trigger_mode = 0
        self.action = STOP
        self.exposure_us = self.period_us = 4000
        self.data_inverted = self.currents_inverted = False
        self.configuration = b"\0\0\0\0"
        self.trigger_out = b"\0\xbb\xbb"
        self.led_currents = b"\x80\x80\x80"
        self.led_enables = BY_SEQUENCER
        self.mailbox = self.mailbox_address = 0
        self._lut: dict[int, Entry] = {}
        self._images = [0] * IMAGE_ENTRIES
        self._validation: int | None = None
        self._validated_s = 0.0
        self._paused_at = 0
        self._awaited: int | None = None
        self._rest()
        self._update_light()

    @property
    def flash_images(self) -> int:
        """How many images the flash memory holds."""
        return len(self._flash)

    # --- settings

    def set_standby(self, mode: int) -> None:
        """Go to standby, or come back."""
        self.standby = bool(_within(mode, 1))
        self._halt()
        self._update_light()

    def park(self, on: int) -> None:
        """Park or free the mirrors."""
        self.parked = bool(_within(on, 1))
        self._halt()

    def set_mode(self, mode: int) -> None:
        """Choose video (0) or patterns (1)."""
        self.pattern_mode = bool(_within(mode, 1))
        self._halt()
        self._update_light()

    def set_source(self, source: int) -> None:
        """Take patterns from the video input (0) or from flash (3)."""
        if source not in (VIDEO, FLASH):
            raise Refused
        self._change()
        self.source = source

    def set_trigger_mode(self, mode: int) -> None:
        """Choose the trigger mode: 0 vertical sync, 1 internal or external."""
        self._change()
        self.trigger_mode = _within(mode, 1)

    def set_times(self, exposure_us: int, period_us: int) -> None:
        """Set exposure and frame period."""
        self._change()
        self.exposure_us, self.period_us = exposure_us, period_us

    def invert_data(self, on: int) -> None:
        """Exchange light and dark of all patterns."""
        self._change()
        self.data_inverted = bool(_within(on, 1))

    def configure(self, data: bytes) -> None:
        """Set number of entries - 1, repeat, patterns a TRIG_OUT_2 - 1, number of images - 1."""
        self._change()
        if data[0] >= LUT_ENTRIES or data[1] > 1:
            raise Refused
        self.configuration = data

    def set_trigger_out(self, data: bytes) -> None:
        """Set polarity and delays of TRIG_OUT_1."""
        self._change()
        self.trigger_out = data

    def open_mailbox(self, mailbox: int) -> None:
        """Open a table for writing, or close it (0)."""
        self.mailbox = _within(mailbox, PATTERN_MAILBOX)

    def set_mailbox_address(self, address: int) -> None:
        """Set where the open table is written next."""
        self.mailbox_address = _within(address, LUT_ENTRIES - 1)

    def write_mailbox(self, data: bytes) -> None:
        """Write entries of the open table."""
        self._change()
        if self.mailbox == PATTERN_MAILBOX:
            count = len(data) // 3
            if not data or len(data) % 3 or self.mailbox_address + count > LUT_ENTRIES:
                raise Refused
            for place in range(count):
                word = int.from_bytes(data[3 * place : 3 * place + 3], "little")
                self._lut[self.mailbox_address + place] = Entry(word)
        elif self.mailbox == IMAGE_MAILBOX:
            if not data or self.mailbox_address + len(data) > IMAGE_ENTRIES:
                raise Refused
            self._images[self.mailbox_address : self.mailbox_address + len(data)] = data
        else:
            raise Refused

    def read_mailbox(self) -> bytes:
        """Return the open table from the address on."""
        if self.mailbox == PATTERN_MAILBOX:
            places = range(self.mailbox_address, self.configuration[0] + 1)
            return b"".join(self._lut.get(place, Entry(0)).word.to_bytes(3, "little") for place in places)
        if self.mailbox == IMAGE_MAILBOX:
            return bytes(self._images[self.mailbox_address : self.configuration[3] + 1])
        raise Refused

    def _change(self) -> None:
        """Make sure that a setting of the pattern mode may change; it undoes the validation."""
        if self.action == START:
            raise Refused
        self._validation = None

    # --- light

    def set_led_currents(self, data: bytes) -> None:
        """Set the currents of red, green and blue, 255 being full."""
        self.led_currents = data
        self._update_light()

    def invert_currents(self, on: int) -> None:
        """Let 0 be full current."""
        self.currents_inverted = bool(_within(on, 1))
        self._update_light()

    def set_led_enables(self, bits: int) -> None:
        """Switch red, green, blue by hand (bits 0 to 2), or leave them to the sequencer (bit 3)."""
        self.led_enables = _within(bits, 0x0F)
        self._update_light()

    def _update_light(self) -> None:
        levels = {}
        for bit, (led, current) in enumerate(zip(LED_BITS, self.led_currents, strict=True)):
            on = self.led_enables & BY_SEQUENCER or self.led_enables >> bit & 1
            if on and not self.standby:
                levels[led] = (255 - current if self.currents_inverted else current) / 255
        self.player.light(Light(self._clock.now(), levels))

    # --- validation

    @property
    def validation(self) -> int:
        """The result of the last validation; bit 7 while it is under way or if there was none."""
        if self._validation is None or self._clock.now() < self._validated_s:
            return VALIDATING
        return self._validation

    def validate(self) -> None:
        """Check the tables and the times."""
        entries = self._entries()
        found = 0
        depths = [entry.depth for entry in entries if entry and 1 <= entry.depth <= 8]
        shortest_us = max((SHORTEST_EXPOSURE_US[depth - 1] for depth in depths), default=0)
        gap_us = self.period_us - self.exposure_us
        if self.exposure_us < shortest_us or gap_us < 0:
            found |= BAD_TIMES
        elif 0 < gap_us < LOAD_US:
            found |= TOO_CLOSE
        if any(entry is None or not entry.valid for entry in entries):
            found |= BAD_NUMBERS
        for before, entry in zip([None, *entries], entries, strict=False):
            if entry and entry.shares_trigger and before and before.black_after:
                found |= BAD_TRIGGER_OUT
            if entry and entry.trigger in EXTERNAL and before and not before.black_after and gap_us:
                found |= NO_BLACK
        self._validation = found
        self._validated_s = self._clock.now() + VALIDATION_S

    def _entries(self) -> list[Entry | None]:
        return [self._lut.get(place) for place in range(self.configuration[0] + 1)]

    # --- running

    @property
    def running(self) -> bool:
        """Whether a pattern sequence runs or waits for its trigger."""
        if self.action != START:
            return False
        return self._awaited is not None or self.player.running(self._clock.now())

    def act(self, action: int) -> None:
        """Stop, pause or start the sequence."""
        with self._lock:
            if _within(action, START) == START:
                self._start()
            elif self.action == START:
                # The next start takes up the pattern at which the sequence paused.
                index = self.player.index_at(self._clock.now()) or 0
                entries = self.configuration[0] + 1
                self._paused_at = (self._paused_at + index) % entries if action == PAUSE else 0
                self._halt()
                self.action = action
            elif action == STOP:
                self.action, self._paused_at = STOP, 0

    def abort(self) -> None:
        """Stop for a failure of the sequencer."""
        with self._lock:
            self._halt()
            self.hardware_status |= ABORTED

    def external_trigger(self, time_s: float, *, rising: bool) -> None:
        """Show the patterns that wait for this edge."""
        with self._lock:
            if self._awaited is None:
                return
            groups = self._groups()
            if groups[self._awaited][0][1].trigger != (1 if rising else 2):
                return
            self._show(time_s + LOAD_S, groups[self._awaited], repeat=False)
            following = self._awaited + 1
            if following < len(groups):
                self._awaited = following
            else:
                self._awaited = 0 if self.configuration[1] else None

    def _start(self) -> None:
        if self.action == START and self.running:
            return
        if not self.pattern_mode or self.parked or self.standby:
            raise Refused
        if self._validation is None or self._validation & FATAL:
            raise Refused
        self.action = START
        self.hardware_status = INITIALISED
        groups = self._groups()
        repeat = bool(self.configuration[1])
        now_s = self._clock.now()
        if self.trigger_mode == 0:
            # The first vertical sync from now on.
            start_s = math.ceil(now_s * VSYNC_HZ) / VSYNC_HZ
            self._show(start_s, list(chain.from_iterable(groups)), repeat=repeat)
        elif groups[0][0][1].trigger in EXTERNAL:
            self._rest()
            self._awaited = 0
        else:
            self._show(now_s + LOAD_S, groups[0], repeat=repeat and len(groups) == 1)
            self._awaited = 1 if len(groups) > 1 else None

    def _groups(self) -> list[list[tuple[int, Entry]]]:
        """Return (number of its image, entry), split before every entry that waits for an external edge."""
        numbered = []
        image = -1
        for entry in self._entries():
            assert entry is not None
            image = max(0, image + 1 if entry.swaps else image)
            numbered.append((image, entry))
        groups: list[list[tuple[int, Entry]]] = []
        for image, entry in numbered[self._paused_at :] + numbered[: self._paused_at]:
            if not groups or entry.trigger in EXTERNAL:
                groups.append([])
            groups[-1].append((image, entry))
        return groups

    def _show(self, start_s: float, group: list[tuple[int, Entry]], *, repeat: bool) -> None:
        period_s = self.period_us / 1e6
        pass_s = len(group) * period_s
        if self.trigger_mode == 0:
            pass_s = math.ceil(pass_s * VSYNC_HZ - 1e-6) / VSYNC_HZ
        self.player.show(
            Programme(
                start_s,
                tuple(BitPattern(entry, self._image_source(image), self.data_inverted) for image, entry in group),
                period_s,
                self.exposure_us / 1e6,
                pass_s,
                None if repeat else 1,
                tuple(not entry.shares_trigger for _, entry in group),
                tuple(entry.leds if self.led_enables & BY_SEQUENCER else frozenset(LED_BITS) for _, entry in group),
            )
        )

    def _image_source(self, image: int) -> Callable[[], RgbImage | None]:
        if self.source == VIDEO:
            return self._video
        index = self._images[image] if image < IMAGE_ENTRIES else len(self._flash)
        stored = self._flash[index] if index < len(self._flash) else None
        return lambda: stored

    def _halt(self) -> None:
        """End a sequence."""
        self.action = STOP
        self._rest()

    def _rest(self) -> None:
        """Show what is shown without a sequence: the video input, in video mode."""
        self._awaited = None
        shows_video = not (self.pattern_mode or self.parked or self.standby)
        patterns = (VideoImage(self._video),) if shows_video else ()
        self.player.show(Programme(self._clock.now(), patterns))


def _within(value: int, highest: int) -> int:
    if not 0 <= value <= highest:
        raise Refused
    return value
