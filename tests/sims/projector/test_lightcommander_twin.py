"""The simulated LightCommander through plain pyusb: golden frames of its invented wire format, planes,
timing, light."""

import errno
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import usb.core
import usb.util
from hypothesis import given, settings
from hypothesis import strategies as st

from sims.clock import ManualClock
from sims.projector.lightcommander import LightCommander
from sims.projector.sequence_file import Sequence, batch_file, batch_steps, decode, encode
from sims.projector.usb_backend import get_backend
from sims.projector.usb_bus import UsbBus

LOAD_S = 230e-6
DONE, UNKNOWN, LENGTH, CHECKSUM, VALUE, NOT_NOW, MISMATCH, TOO_FAST, TOO_HOT = range(9)
FIRST, STEP, ONCE, REPEAT, STOP, PARK, UNPARK = range(0x0101, 0x0108)
DOWNLOAD, ORDER, BATCH = 0x0201, 0x0301, 0x0306
LED_ENABLE, INTENSITY, GET_INTENSITY, DRIVER = 0x0401, 0x0402, 0x0403, 0x0404
SYNC_CONFIGURE, SYNC_ENABLE, EDGE, SOURCE = 0x0501, 0x0502, 0x0601, 0x0602
PARKED, RUNNING, FAULT, LIT, ANY_LIT, HOT = 0x0704, 0x0705, 0x070B, 0x070C, 0x070D, 0x070F
INFRARED = 3
IMAGES = np.random.default_rng(7).integers(0, 256, (4, 768, 1024), np.uint8)


class Bench:
    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock()
        self.video: np.ndarray | None = None
        self.box = LightCommander(self.clock, video=lambda: self.video)
        self.bus = UsbBus(folder / "usb")
        self.bus.add(self.box)
        self.bus.start()
        self.backend = get_backend(self.bus.socket_path)
        self.device = usb.core.find(backend=self.backend, idVendor=0xFFF0, idProduct=0x51AC)
        self.device.set_configuration()

    def close(self) -> None:
        usb.util.dispose_resources(self.device)
        self.backend.finalize()
        self.bus.close()
        self.box.close()

    def ask(self, opcode: int, layout: str = "", *values: object, payload: bytes = b"") -> tuple[int, bytes]:
        """Send a request and return (status, payload) of its reply."""
        payload = payload or struct.pack("<" + layout, *values)
        frame = struct.pack("<BBHI", 0xA5, 9, opcode, len(payload)) + payload
        self.device.write(0x02, frame + struct.pack("<H", sum(frame) & 0xFFFF))
        reply = bytes(self.device.read(0x86, 512))
        mark, sequence, answered, status, zero, count = struct.unpack_from("<BBHBBH", reply)
        assert (mark, sequence, answered, zero) == (0x5A, 9, opcode, 0)
        assert reply[-2:] == struct.pack("<H", sum(reply[:-2]) & 0xFFFF)
        assert len(reply) == 10 + count
        return status, reply[8:-2]

    def do(self, opcode: int, layout: str = "", *values: object, payload: bytes = b"") -> bytes:
        status, answer = self.ask(opcode, layout, *values, payload=payload)
        assert status == DONE
        return answer

    def sequence(self, exposure_us: float, period_us: float, bits: int = 8, led: str = "infrared") -> int:
        text = batch_file(Sequence(exposure_us, period_us, bits, (led,)))
        return self.ask(BATCH, payload=text.encode())[0]

    def load(self, images: np.ndarray, bits: int = 8) -> None:
        for number, image in enumerate(images):
            for bit in range(bits):
                plane = np.packbits(image >> bit & 1, axis=1, bitorder="little").tobytes()
                self.do(DOWNLOAD, payload=struct.pack("<H", number * bits + bit) + plane)
        self.do(ORDER, f"BH{len(images)}H", bits, len(images), *range(len(images)))

    def infrared(self, percent: float = 50.0) -> None:
        self.do(INTENSITY, "Bd", INFRARED, percent)
        self.do(LED_ENABLE, "BB", INFRARED, 1)
        self.do(DRIVER, "B", 1)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.close()


def exchange(bench: Bench, request: str) -> str:
    bench.device.write(0x02, bytes.fromhex(request))
    return bytes(bench.device.read(0x86, 512)).hex(" ")


def test_golden_frames_written_from_the_wire_format(bench: Bench) -> None:
    assert exchange(bench, "a5 07 04 04 01 00 00 00 01 b6 00") == "5a 07 04 04 00 00 00 00 69 00"
    # Intensity of the infrared LED 50 %, and back.
    assert exchange(bench, "a5 01 02 04 09 00 00 00 03 00 00 00 00 00 00 49 40 41 01").startswith("5a 01 02 04 00")
    assert exchange(bench, "a5 02 03 04 01 00 00 00 03 b2 00") == (
        "5a 02 03 04 00 00 08 00 00 00 00 00 00 00 49 40 f4 00"
    )
    # Communication status; an unknown opcode; a wrong checksum; a wrong length.
    assert exchange(bench, "a5 03 01 07 00 00 00 00 b0 00") == "5a 03 01 07 00 00 00 00 65 00"
    assert exchange(bench, "a5 04 ff ff 00 00 00 00 a7 02") == "5a 04 ff ff 01 00 00 00 5d 02"
    assert exchange(bench, "a5 05 01 07 00 00 00 00 b3 00") == "5a 05 01 07 03 00 00 00 6a 00"
    assert exchange(bench, "a5 06 04 04 02 00 00 00 01 01 b7 00") == "5a 06 04 04 02 00 00 00 6a 00"


def test_a_request_may_come_in_pieces_and_after_noise(bench: Bench) -> None:
    request = bytes.fromhex("a5 03 01 07 00 00 00 00 b0 00")
    for piece in (b"\x00\x11" + request[:1], request[1:5], request[5:] + request):
        bench.device.write(0x02, piece)
    for _ in range(2):
        assert bytes(bench.device.read(0x86, 512)).hex(" ") == "5a 03 01 07 00 00 00 00 65 00"


def test_planes_hold_x_0_in_bit_0_and_rows_in_order(bench: Bench) -> None:
    plane = bytearray(98304)
    plane[0] = 0b0000_0101  # row 0: x = 0 and x = 2
    plane[128 * 5 + 127] = 0b1000_0000  # row 5: x = 1023
    assert bench.sequence(1000, 1000, bits=1) == DONE
    bench.infrared()
    bench.do(DOWNLOAD, payload=struct.pack("<H", 959) + bytes(plane))
    bench.do(ORDER, "BHH", 1, 1, 959)
    bench.do(FIRST)
    bench.clock.advance(0.001)
    image = bench.box.showing().image
    assert image is not None
    assert np.argwhere(image).tolist() == [[0, 0], [0, 2], [5, 1023]]
    assert image[0, 0] == 255


def test_a_pattern_appears_after_the_load_time_and_stays(bench: Bench) -> None:
    assert bench.sequence(40_000, 50_000) == DONE
    bench.load(IMAGES)
    bench.infrared()
    bench.do(FIRST)
    shown_s = bench.box.player.programme.start_s
    bench.do(RUNNING)
    assert bench.box.player.shown_at(shown_s - 1e-6).image is None
    shown = bench.box.player.shown_at(shown_s)
    assert shown[1:] == ("infrared", 0.5)
    assert np.array_equal(shown.image, IMAGES[0])
    bench.clock.advance(10)
    for expected in (1, 2, 3, 0):
        bench.do(STEP)
        bench.clock.advance(0.001)
        assert np.array_equal(bench.box.showing().image, IMAGES[expected])


def test_an_automatic_pass_shows_every_image_for_its_exposure_with_an_edge_each(bench: Bench) -> None:
    assert bench.sequence(8_000, 10_000) == DONE
    bench.load(IMAGES)
    bench.infrared()
    edges: list[float] = []
    bench.box.on_sync(edges.append, 2)
    bench.do(SYNC_CONFIGURE, "BBII", 2, 1, 300, 100)
    bench.do(SYNC_ENABLE, "BB", 2, 1)
    bench.do(ONCE)
    start_s = bench.box.player.programme.start_s
    assert bench.do(RUNNING) == b"\x01"
    bench.clock.advance(1)
    assert bench.do(RUNNING) == b"\x00"
    assert edges == pytest.approx([start_s + 300e-6 + k * 0.01 for k in range(4)])
    for k in range(4):
        shown = bench.box.player.shown_at(start_s + k * 0.01 + 0.0079)
        assert np.array_equal(shown.image, IMAGES[k])
        assert bench.box.player.shown_at(start_s + k * 0.01 + 0.0081).led == "none"
    bench.do(REPEAT)
    bench.clock.advance(10)
    assert len(edges) == 4 + 1000
    bench.do(STOP)
    bench.clock.advance(1)
    assert len(edges) == 1004
    assert bench.box.showing().image is None


def test_a_triggered_pass_waits_for_every_edge(bench: Bench) -> None:
    assert bench.sequence(8_000, 10_000) == DONE
    bench.load(IMAGES[:2])
    bench.infrared()
    bench.do(SOURCE, "B", 4)
    bench.do(EDGE, "B", 0)
    bench.do(ONCE)
    for expected in (0, 1):
        bench.clock.advance(1)
        assert bench.box.showing().image is None
        assert bench.do(RUNNING) == b"\x01"
        bench.box.external_trigger(bench.clock.now(), rising=True)
        bench.box.external_trigger(bench.clock.now(), rising=False)
        bench.clock.advance(0.001)
        assert np.array_equal(bench.box.showing().image, IMAGES[expected])
    bench.clock.advance(1)
    assert bench.do(RUNNING) == b"\x00"


def test_a_plane_takes_the_time_of_the_line(bench: Bench) -> None:
    begun_s = bench.clock.now()
    bench.do(DOWNLOAD, payload=bytes(2 + 98304))
    assert bench.clock.now() - begun_s == pytest.approx(98316 / 30e6)


@pytest.mark.parametrize(
    ("bits", "period_us", "expected"), [(1, 200, DONE), (1, 199, TOO_FAST), (8, 1429, DONE), (8, 1428, TOO_FAST)]
)
def test_sequences_faster_than_the_mirrors_are_refused(bench: Bench, bits: int, period_us: int, expected: int) -> None:
    assert bench.sequence(period_us, period_us, bits) == expected


def test_what_cannot_be_is_refused(bench: Bench) -> None:
    assert bench.ask(FIRST)[0] == NOT_NOW
    assert bench.ask(DOWNLOAD, payload=struct.pack("<H", 960) + bytes(98304))[0] == VALUE
    assert bench.ask(DOWNLOAD, payload=bytes(98304))[0] == LENGTH
    assert bench.ask(ORDER, "BHH", 8, 1, 120)[0] == VALUE
    assert bench.ask(ORDER, "BHH", 8, 2, 1)[0] == LENGTH
    assert bench.ask(ORDER, "BH", 8, 0)[0] == VALUE
    assert bench.ask(BATCH, payload=b"$L2.5 FormatDisk\n")[0] == VALUE
    assert bench.ask(LED_ENABLE, "BB", 4, 1)[0] == VALUE
    assert bench.ask(INTENSITY, "Bd", INFRARED, float("nan"))[0] == VALUE
    assert bench.ask(INTENSITY, "Bd", INFRARED, 100.1)[0] == VALUE
    assert bench.ask(SYNC_ENABLE, "BB", 3, 1)[0] == VALUE
    assert bench.ask(SOURCE, "B", 7)[0] == VALUE
    bench.do(ORDER, "BHH", 8, 1, 0)
    assert bench.sequence(10_000, 10_000, bits=1) == DONE
    assert bench.ask(FIRST)[0] == MISMATCH
    assert bench.sequence(10_000, 10_000) == DONE
    assert bench.ask(STEP)[0] == NOT_NOW
    bench.do(FIRST)
    bench.do(PARK)
    assert bench.do(PARKED) == b"\x01"
    assert bench.ask(FIRST)[0] == NOT_NOW
    bench.do(UNPARK)
    bench.do(FIRST)


def test_the_sequence_can_be_read_back_and_comes_from_the_words_alone(bench: Bench) -> None:
    text = batch_file(Sequence(40_000, 50_000, 8, ("infrared",))).replace("40000 usec", "1 usec")
    bench.do(BATCH, payload=text.encode())
    assert struct.unpack("<d", bench.do(0x0707)) == (40_000,)
    assert struct.unpack("<d", bench.do(0x0708)) == (20,)
    assert bench.do(0x0706) == b"\x08"
    bench.do(0x0302)
    for word in encode(Sequence(1_000, 2_000, 1, ("red",))):
        bench.do(0x0304, "II", 0x1111, word)
    bench.do(0x0303)
    assert bench.do(0x0706) == b"\x01"
    assert bench.ask(0x0303)[0] == NOT_NOW
    bench.do(0x0304, "II", 0x4C4, 833333)
    assert bench.do(0x0305, "I", 0x4C4) == struct.pack("<I", 833333)


def test_only_leds_that_are_enabled_and_named_by_the_sequence_are_lit(bench: Bench) -> None:
    assert bench.sequence(10_000, 10_000, led="infrared") == DONE
    bench.infrared(40)
    bench.do(INTENSITY, "Bd", 0, 60.0)
    bench.do(LED_ENABLE, "BB", 0, 1)
    assert [bench.do(LIT, "B", led)[0] for led in range(4)] == [0, 0, 0, 1]
    assert bench.box.showing()[1:] == ("infrared", 0.4)
    bench.do(DRIVER, "B", 0)
    assert bench.do(ANY_LIT) == b"\x00"
    assert bench.box.showing().led == "none"


def test_sixty_per_cent_lasts_and_more_gets_too_hot(bench: Bench) -> None:
    bench.infrared(60)
    bench.clock.advance(3600)
    assert (bench.do(HOT), bench.do(ANY_LIT)) == (b"\x00", b"\x01")
    bench.do(INTENSITY, "Bd", INFRARED, 100.0)
    bench.clock.advance(10)
    assert (bench.do(HOT), bench.do(ANY_LIT)) == (b"\x01", b"\x00")
    assert bench.box.showing().led == "none"
    assert bench.ask(DRIVER, "B", 1)[0] == TOO_HOT
    bench.do(DRIVER, "B", 0)
    bench.do(INTENSITY, "Bd", INFRARED, 50.0)
    bench.clock.advance(10)
    bench.do(DRIVER, "B", 1)
    assert (bench.do(HOT), bench.do(ANY_LIT)) == (b"\x00", b"\x01")


def test_faults_of_the_box(bench: Bench) -> None:
    bench.infrared()
    bench.box.faults.led = "infrared"
    assert (bench.do(FAULT), bench.do(LIT, "B", INFRARED)) == (b"\x01", b"\x00")
    bench.box.faults.led = None
    assert (bench.do(FAULT), bench.do(LIT, "B", INFRARED)) == (b"\x00", b"\x01")
    with pytest.raises(ValueError, match="no LED"):
        bench.box.faults.led = "ultraviolet"
    bench.box.faults.overheat()
    assert (bench.do(HOT), bench.do(ANY_LIT)) == (b"\x01", b"\x00")
    edges: list[float] = []
    bench.box.on_sync(edges.append)
    bench.do(SYNC_ENABLE, "BB", 0, 1)
    bench.load(IMAGES[:1])
    assert bench.sequence(10_000, 10_000) == DONE
    bench.box.faults.miss_sync()
    bench.do(FIRST)
    bench.clock.advance(1)
    assert edges == []
    bench.do(STEP)
    bench.clock.advance(1)
    assert len(edges) == 1


def test_faults_of_the_line_leave_the_box_as_it_was(bench: Bench) -> None:
    bench.infrared(30)
    bench.box.faults.usb.stall_next()
    with pytest.raises(usb.core.USBError) as caught:
        bench.do(ANY_LIT)
    assert caught.value.errno == errno.EPIPE
    bench.device.clear_halt(0x02)
    bench.box.faults.usb.unplug()
    with pytest.raises(usb.core.USBError) as caught:
        bench.do(ANY_LIT)
    assert caught.value.errno == errno.ENODEV
    assert bench.box.showing()[1:] == ("infrared", 0.3)
    bench.box.faults.usb.replug()
    usb.util.dispose_resources(bench.device)
    bench.device = usb.core.find(backend=bench.backend, idVendor=0xFFF0)
    bench.device.set_configuration()
    assert bench.do(ANY_LIT) == b"\x01"


def test_the_video_input_is_shown_with_dvi_as_source(bench: Bench) -> None:
    bench.infrared()
    bench.do(SOURCE, "B", 0)
    assert not bench.box.showing().image.any()
    bench.video = IMAGES[2]
    assert np.array_equal(bench.box.showing().image, IMAGES[2])
    assert bench.ask(FIRST)[0] == NOT_NOW
    bench.do(SOURCE, "B", 3)
    assert bench.box.showing().image is None


@given(
    exposure=st.floats(1, 1e7),
    gap=st.floats(0, 1e6),
    bits=st.integers(1, 8),
    leds=st.lists(st.sampled_from(["red", "green", "blue", "infrared"]), min_size=1, unique=True),
)
def test_a_batch_file_says_what_was_asked(exposure: float, gap: float, bits: int, leds: list[str]) -> None:
    text = batch_file(Sequence(exposure, exposure + gap, bits, tuple(leds)))
    steps = batch_steps(text)
    assert steps is not None
    found = decode([value for step, register, value in steps if register == 0x1111])
    assert found is not None
    assert found.exposure_us == pytest.approx(exposure, abs=0.06)
    assert found.period_us == pytest.approx(exposure + gap, abs=0.06)
    assert (found.bits, set(found.leds)) == (bits, set(leds))


@settings(max_examples=50)
@given(st.lists(st.binary(max_size=64), max_size=8))
def test_garbage_never_breaks_the_box(chunks: list[bytes]) -> None:
    box = LightCommander(ManualClock())
    for chunk in chunks:
        box.take(0x02, b"\xa5" + chunk)
    box.showing()
