"""The simulated DLPC350, spoken to through plain pyusb with frames written by hand from the public
protocol."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import usb.core
import usb.util
from hypothesis import given, settings
from hypothesis import strategies as st

from sims.clock import ManualClock
from sims.projector.dlpc350 import Dlpc350
from sims.projector.usb_backend import get_backend
from sims.projector.usb_bus import UsbBus


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (1140, 912, 3), np.uint8)


class Bench:
    def __init__(self, folder: Path, **options) -> None:
        self.clock = ManualClock(100.0)
        self.video = picture(1)
        self.box = Dlpc350(self.clock, video=lambda: self.video, flash=[picture(2), picture(3)], **options)
        self.bus = UsbBus(folder / "usb")
        self.bus.add(self.box)
        self.bus.start()
        self.backend = get_backend(self.bus.socket_path)
        self.device = usb.core.find(backend=self.backend, idVendor=0x0451, idProduct=0x6401)

    def open(self) -> "Bench":
        self.device.set_configuration()
        return self

    def close(self) -> None:
        usb.util.dispose_resources(self.device)
        self.backend.finalize()
        self.bus.close()

    def talk(self, *frame: str) -> bytes:
        data = bytes.fromhex("".join(frame))
        self.device.write(0x01, data + bytes(-len(data) % 64))
        return bytes(self.device.read(0x81, 64))

    def write(self, *frames: str) -> None:
        """Send frames that must be acknowledged: no refusal, no data."""
        for frame in frames:
            reply = self.talk(frame)
            assert reply[0] == 0x40, f"refused: {frame}"
            assert reply[2:4] == b"\0\0"

    def refused(self, frame: str) -> bool:
        return bool(self.talk(frame)[0] & 0x20)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path).open()
    yield bench
    bench.close()


STOP = "40 00 03 00 24 1A 00"
START = "40 00 03 00 24 1A 02"
PATTERN_MODE = "40 00 03 00 1B 1A 01"
FROM_FLASH = "40 00 03 00 22 1A 03"
BY_TRIGGER = "40 00 03 00 23 1A 01"
VALIDATE = "40 00 02 00 1A 1A"
READ_VALIDATION = "C0 00 02 00 1A 1A"
READ_MAIN = "C0 00 02 00 0C 1A"
TIMES_10_MS = "40 00 0A 00 29 1A 10 27 00 00 10 27 00 00"
OPEN_PATTERNS = "40 00 03 00 33 1A 02"
CLOSE = "40 00 03 00 33 1A 00"
FIRST = "40 00 03 00 32 1A 00"
# Two entries, repeated: 8 bits of green with the red LED; then 8 bits of red, green LED, continued.
TWO = "40 00 06 00 31 1A 01 01 01 00"
TWO_ENTRIES = "40 00 08 00 34 1A 00 18 00 07 28 00"


def set_up(bench: Bench, *more: str) -> None:
    bench.write(STOP, PATTERN_MODE, TWO, BY_TRIGGER, TIMES_10_MS, *more, OPEN_PATTERNS, FIRST, TWO_ENTRIES, CLOSE)


def test_the_start_frame_of_the_documents_starts_a_validated_sequence(bench: Bench) -> None:
    set_up(bench)
    bench.write(VALIDATE)
    assert bench.talk(READ_VALIDATION)[4] == 0x80
    bench.clock.advance(0.02)
    assert bench.talk(READ_VALIDATION)[:5] == bytes.fromhex("C0 00 01 00 00")
    assert bench.talk(READ_MAIN)[4] == 0b0000
    bench.write(START)
    assert bench.talk(READ_MAIN)[4] == 0b0010
    bench.clock.advance(0.001)
    red = bench.box.showing()
    assert (red.led, red.level) == ("red", pytest.approx(128 / 255))
    assert np.array_equal(red.image, bench.video[..., 1])
    bench.clock.advance(0.01)
    green = bench.box.showing()
    assert green.led == "green"
    assert np.array_equal(green.image, bench.video[..., 0])
    bench.clock.advance(0.01)
    assert bench.box.showing().led == "red"
    bench.write(STOP)
    assert bench.talk(READ_MAIN)[4] == 0
    assert bench.box.showing().image is None


def test_the_trigger_output_rises_with_every_pattern(bench: Bench) -> None:
    edges: list[float] = []
    bench.box.on_sync(edges.append)
    set_up(bench)
    bench.write(VALIDATE, START)
    bench.clock.advance(0.035)
    assert edges == pytest.approx([100.00023, 100.01023, 100.02023, 100.03023])
    bench.box.faults.miss_sync()
    bench.clock.advance(0.02)
    assert edges[4:] == pytest.approx([100.05023])


@pytest.mark.parametrize(
    ("exposure", "period", "found"),
    [
        ("10 27 00 00", "10 27 00 00", 0x00),
        ("10 27 00 00", "F6 27 00 00", 0x00),
        ("10 27 00 00", "F5 27 00 00", 0x10),
        ("11 27 00 00", "10 27 00 00", 0x01),
        ("8C 20 00 00", "8C 20 00 00", 0x01),
        ("8D 20 00 00", "8D 20 00 00", 0x00),
    ],
    ids=["equal", "230 us shorter", "229 us shorter", "longer", "8332 us", "8333 us"],
)
def test_the_exposure_is_the_period_or_at_least_230_us_shorter(
    bench: Bench, exposure: str, period: str, found: int
) -> None:
    set_up(bench, f"40 00 0A 00 29 1A {exposure} {period}")
    bench.write(VALIDATE)
    bench.clock.advance(0.02)
    assert bench.talk(READ_VALIDATION)[4] == found
    assert bench.refused(START) == bool(found)


def test_a_pattern_that_an_image_does_not_hold_is_found(bench: Bench) -> None:
    set_up(bench, OPEN_PATTERNS)
    bench.write(OPEN_PATTERNS, FIRST, "40 00 05 00 34 1A 0C 18 00", VALIDATE)
    bench.clock.advance(0.02)
    assert bench.talk(READ_VALIDATION)[4] == 0x02
    assert bench.refused(START)


def test_a_sequence_needs_validation_and_pattern_mode_and_keeps_its_settings(bench: Bench) -> None:
    assert bench.refused(START)
    set_up(bench)
    assert bench.refused(START)
    bench.write(VALIDATE, START)
    assert bench.refused(TIMES_10_MS)
    assert bench.refused(FROM_FLASH)
    assert bench.talk("C0 00 02 00 29 1A")[4:12] == bytes.fromhex("10 27 00 00 10 27 00 00")


def test_patterns_come_from_flash_by_the_image_table(bench: Bench) -> None:
    one = "40 00 06 00 31 1A 00 01 00 00"
    set_up(bench, FROM_FLASH)
    bench.write(one, "40 00 03 00 33 1A 01", FIRST, "40 00 03 00 34 1A 01", CLOSE, VALIDATE, START)
    bench.clock.advance(0.001)
    assert np.array_equal(bench.box.showing().image, picture(3)[..., 1])
    assert bench.talk("C0 00 02 00 42 1A")[4] == 2


def test_bits_are_counted_from_the_lowest_of_green_over_red_to_blue(bench: Bench) -> None:
    bench.write(STOP, PATTERN_MODE, BY_TRIGGER, TIMES_10_MS, "40 00 06 00 31 1A 02 01 00 00", OPEN_PATTERNS)
    # 1 bit: numbers 7 (green 7), 8 (red 0), 23 (blue 7), the last inverted.
    bench.write(FIRST, "40 00 0B 00 34 1A 1C 71 00 23 71 00 5F 71 01", VALIDATE, START)
    green, red, blue = bench.video[..., 1], bench.video[..., 0], bench.video[..., 2]
    for expected in (green >> 7, red & 1, 1 - (blue >> 7)):
        bench.clock.advance(0.005)
        shown = bench.box.showing()
        assert np.array_equal(shown.image, expected * 255)
        assert shown.led == "red+green+blue"
        bench.clock.advance(0.005)


def test_an_entry_with_an_external_trigger_waits_for_its_edge(bench: Bench) -> None:
    set_up(bench)
    bench.write(OPEN_PATTERNS, FIRST, "40 00 05 00 34 1A 01 18 00", VALIDATE, START)
    bench.clock.advance(1.0)
    assert bench.box.showing().image is None
    bench.box.external_trigger(bench.clock.now(), rising=False)
    bench.clock.advance(0.001)
    assert bench.box.showing().image is None
    bench.box.external_trigger(bench.clock.now())
    bench.clock.advance(0.001)
    assert np.array_equal(bench.box.showing().image, bench.video[..., 1])
    bench.clock.advance(0.1)
    assert bench.box.showing().image is None
    assert bench.talk(READ_MAIN)[4] == 0b0010


def test_led_currents_set_the_level(bench: Bench) -> None:
    bench.write("40 00 05 00 01 0B 33 00 00")
    assert bench.talk("C0 00 02 00 01 0B")[4:7] == bytes.fromhex("33 00 00")
    assert bench.box.showing()[1:] == ("red", pytest.approx(0.2))
    bench.write("40 00 03 00 05 1A 01")
    assert bench.box.showing()[1:] == ("red+green+blue", pytest.approx(1.0))
    bench.write("40 00 03 00 07 1A 02")
    assert bench.box.showing().led == "green"
    bench.write("40 00 03 00 07 1A 00")
    assert bench.box.showing().level == 0


def test_video_mode_shows_the_input_and_parked_mirrors_nothing(bench: Bench) -> None:
    assert np.array_equal(bench.box.showing().image, bench.video.mean(axis=2).round())
    bench.write("40 00 03 00 09 06 01")
    assert bench.box.showing().image is None
    assert bench.talk(READ_MAIN)[4] == 0b0001
    bench.write("40 00 03 00 09 06 00", "40 00 03 00 00 02 01")
    assert bench.box.showing().led == "none"


def test_a_pause_is_taken_up_at_the_same_pattern(bench: Bench) -> None:
    set_up(bench)
    bench.write(VALIDATE, START)
    bench.clock.advance(0.015)
    assert bench.box.showing().led == "green"
    bench.write("40 00 03 00 24 1A 01")
    assert bench.box.showing().image is None
    bench.write(VALIDATE, START)
    bench.clock.advance(0.001)
    assert bench.box.showing().led == "green"


def test_a_long_message_is_continued_in_further_packets(bench: Bench) -> None:
    entries = b"".join((0x1800 | 1 << 16 * (k % 2)).to_bytes(3, "little") for k in range(40))
    message = bytes.fromhex("40 05 7A 00 34 1A") + entries
    bench.write(STOP, OPEN_PATTERNS, FIRST, "40 00 06 00 31 1A 27 01 00 00")
    bench.device.write(0x01, message[:64])
    bench.device.write(0x01, (message[64:] + bytes(2))[:64])
    assert bytes(bench.device.read(0x81, 64))[:4] == bytes.fromhex("40 05 00 00")
    bench.write(FIRST)
    reply = bench.talk("C0 00 02 00 34 1A") + bytes(bench.device.read(0x81, 64))
    assert reply[:4] == bytes.fromhex("C0 00 78 00")
    assert reply[4:124] == entries


def test_what_is_not_known_is_refused_and_writes_without_reply_are_silent(bench: Bench) -> None:
    assert bench.refused("40 00 03 00 01 30 01")
    assert bench.refused("C0 00 02 00 EE EE")
    assert bench.refused("40 00 04 00 1B 1A 01 00")
    assert bench.refused("40 00 03 00 1B 1A 02")
    bench.box.faults.refuse_next()
    assert bench.refused(STOP)
    bench.device.write(0x01, bytes.fromhex("00 00 03 00 24 1A 00") + bytes(57))
    with pytest.raises(usb.core.USBTimeoutError):
        bench.device.read(0x81, 64, timeout=30)


def test_an_aborted_sequence_shows_in_the_hardware_status(bench: Bench) -> None:
    assert bench.talk("C0 00 02 00 0A 1A")[4] == 0x01
    set_up(bench)
    bench.write(VALIDATE, START)
    bench.box.faults.abort_sequence()
    assert bench.talk("C0 00 02 00 0A 1A")[4] == 0x41
    assert bench.talk(READ_MAIN)[4] == 0


def test_a_kernel_driver_must_be_detached_first(tmp_path: Path) -> None:
    bench = Bench(tmp_path, kernel_driver=True)
    assert bench.device.is_kernel_driver_active(0)
    with pytest.raises(usb.core.USBError, match="Resource busy"):
        bench.device.set_configuration()
    bench.device.detach_kernel_driver(0)
    bench.open()
    assert bench.talk(READ_MAIN)[4] == 0
    bench.close()


@settings(max_examples=50)
@given(st.lists(st.binary(min_size=1, max_size=64), max_size=6))
def test_garbage_never_breaks_the_controller(packets: list[bytes]) -> None:
    box = Dlpc350(ManualClock())
    for packet in packets:
        box.take(0x01, packet)
    box.showing()
