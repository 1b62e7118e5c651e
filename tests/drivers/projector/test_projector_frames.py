"""Golden frames, written by hand from the documents, and whatever else may come by the line."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, GarbledReply, InstrumentError
from drivers.projector.bitplanes import pack
from drivers.projector.dlpc350_frames import StaleReply as OldReply
from drivers.projector.dlpc350_frames import decode, encode, pattern_entry
from drivers.projector.sequence_file import parse_sequence_text, read_sequence_file
from drivers.projector.usb_frames import StaleReply, decode_reply, decode_result, encode_request
from drivers.projector.usb_profile import UsbProfile, load_profile
from drivers.settings import read_file
from drivers.values import Led


def frames(text: str) -> list[bytes]:
    data = bytes.fromhex(text)
    return [data + bytes(64 - len(data))]


def test_dlpc350_messages() -> None:
    """Programmer's guide DLPU010: `flags sequence lengthL lengthH CMD3 CMD2 data`."""
    assert encode(0x1A24, 0, b"\2") == frames("40 00 03 00 24 1A 02")
    assert encode(0x1A24, 7, b"\0") == frames("40 07 03 00 24 1A 00")
    assert encode(0x1A0C, 1, read=True) == frames("C0 01 02 00 0C 1A")
    assert encode(0x1A07, 2, b"\4") == frames("40 02 03 00 07 1A 04")
    assert encode(0x0B01, 3, bytes([0, 153, 0])) == frames("40 03 05 00 01 0B 00 99 00")
    assert encode(0x1A29, 4, struct.pack("<II", 10_000, 10_230)) == frames("40 04 0A 00 29 1A 10 27 00 00 F6 27 00 00")


def test_dlpc350_messages_longer_than_a_packet_go_on_in_the_next() -> None:
    packets = encode(0x1A34, 5, bytes(range(1, 121)))
    assert [len(packet) for packet in packets] == [64, 64]
    assert packets[0][:6] == bytes.fromhex("40 05 7A 00 34 1A")
    assert (packets[0][6:] + packets[1])[:120] == bytes(range(1, 121))
    assert packets[1][62:] == b"\0\0"


def test_dlpc350_pattern_entries() -> None:
    # Number 0, 8 bits, red; the same with a new image; number 23, 1 bit, all LEDs.
    assert pattern_entry(0, 8, 0b001, swap=False) == bytes.fromhex("00 18 00")
    assert pattern_entry(0, 8, 0b001, swap=True) == bytes.fromhex("00 18 04")
    assert pattern_entry(23, 1, 0b111, swap=False) == bytes.fromhex("5C 71 00")


@given(st.binary(max_size=64), st.booleans())
def test_dlpc350_replies_are_data_or_a_typed_error(packet: bytes, read: bool) -> None:
    try:
        decode("projector1", 0x1A0C, 1, packet, read=read)
    except (InstrumentError, OldReply):
        return


@given(st.integers(0, 255), st.integers(0, 255), st.integers(0, 70), st.booleans())
def test_dlpc350_heads_are_data_or_a_typed_error(flags: int, sequence: int, length: int, read: bool) -> None:
    packet = bytes([flags, sequence, length, 0]).ljust(64, b"\1")
    try:
        data = decode("projector1", 0x1A0C, 1, packet, read=read)
    except (InstrumentError, OldReply):
        return
    assert (flags, sequence) == (0xC0 if read else 0x40, 1)
    assert data == b"\1" * length


def test_a_plane_has_x_0_in_bit_0_and_its_rows_in_order() -> None:
    image = np.zeros((768, 1024), np.uint8)
    image[0, 0] = 0x80
    image[0, 9] = 0x81
    image[1, 0] = 0x01
    image[767, 1023] = 0x40
    planes = pack(image, 8)
    assert [len(plane) for plane in planes] == [98304] * 8
    assert (planes[7][0], planes[7][1]) == (0b0000_0001, 0b0000_0010)
    assert (planes[0][1], planes[0][128]) == (0b0000_0010, 0b0000_0001)
    assert planes[6][98303] == 0b1000_0000
    assert [sum(plane) for plane in planes] == [3, 0, 0, 0, 0, 0, 128, 3]


@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_fewer_bits_are_the_upper_ones(bits: int, seed: int) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (768, 1024), np.uint8)
    assert pack(image, bits) == pack(image, 8)[8 - bits :]


# --- the invented format of the simulated LightCommander


@pytest.fixture(scope="module")
def sim() -> UsbProfile:
    return load_profile("lightcommander-sim", device="projector1")


def request(sim: UsbProfile, operation: str, sequence: int, **values) -> str:
    return encode_request(sim, sim.operations[operation], sequence, values).hex(" ")


def test_requests_of_the_simulated_box(sim: UsbProfile) -> None:
    assert request(sim, "DLP_LED_LEDdriverEnable", 7, on=1) == "a5 07 04 04 01 00 00 00 01 b6 00"
    assert request(sim, "DLP_Status_CommunicationStatus", 3) == "a5 03 01 07 00 00 00 00 b0 00"
    assert request(sim, "DLP_LED_SetLEDintensity", 1, led=3, percent=50.0) == (
        "a5 01 02 04 09 00 00 00 03 00 00 00 00 00 00 49 40 41 01"
    )
    assert request(sim, "DLP_RegIO_WriteImageOrderLut", 0, bits_per_pixel=8, order=(2, 258), count=2) == (
        "a5 00 01 03 07 00 00 00 08 02 00 02 00 02 01 bf 00"
    )


def test_replies_of_the_simulated_box(sim: UsbProfile) -> None:
    layout = sim.operations["DLP_LED_LEDdriverEnable"]
    good = bytes.fromhex("5a 07 04 04 00 00 00 00 69 00")
    assert decode_reply(sim, "p", layout, 7, good).status == 0
    with pytest.raises(StaleReply):
        decode_reply(sim, "p", layout, 8, good)
    for bad, what in (
        (good[:-1], "ends early"),
        (good + b"\0", "too long"),
        (b"\x5b" + good[1:], "begins wrongly"),
        (good[:-1] + b"\1", "wrong checksum"),
        (b"", "ends early"),
    ):
        with pytest.raises(GarbledReply, match=what):
            decode_reply(sim, "p", layout, 7, bad)


@given(data=st.data())
def test_whatever_comes_is_a_reply_or_a_typed_error(sim: UsbProfile, data: st.DataObject) -> None:
    operation = data.draw(st.sampled_from(sorted(sim.operations)))
    layout = sim.operations[operation]
    payload = data.draw(st.binary(max_size=12))
    head = struct.pack("<BBHBBH", 0x5A, 1, layout.opcode, data.draw(st.integers(0, 255)), 0, len(payload))
    sound = head + payload + struct.pack("<H", sum(head + payload) & 0xFFFF)
    for frame in (sound, data.draw(st.binary(max_size=64)), sound[: data.draw(st.integers(0, len(sound)))]):
        try:
            reply = decode_reply(sim, "p", layout, 1, frame)
            decode_result(sim, "p", layout, reply.payload)
        except (GarbledReply, StaleReply):
            continue


@pytest.mark.parametrize(("kind", "order"), [("sum", "little"), ("xor", "big"), ("none", "little")])
def test_other_framings(tmp_path: Path, kind: str, order: str) -> None:
    text = (Path("drivers/projector/profiles/lightcommander-sim.yaml")).read_text()
    text = text.replace("checksum: sum", f"checksum: {kind}").replace("byte_order: little", f"byte_order: {order}")
    if kind == "none":
        text = text.replace("  - {part: checksum, type: u16}\n", "")
    path = tmp_path / "other.yaml"
    path.write_text(text)
    profile = load_profile(str(path), device="p")
    frame = encode_request(profile, profile.operations["DLP_LED_LEDdriverEnable"], 7, {"on": 1}).hex(" ")
    assert (
        frame
        == {
            "sum": "a5 07 04 04 01 00 00 00 01 b6 00",
            "xor": "a5 07 04 04 00 00 00 01 01 00 a2",
            "none": "a5 07 04 04 01 00 00 00 01",
        }[kind]
    )


def test_the_profile_of_the_real_box_sends_nothing() -> None:
    with pytest.raises(ConfigurationError, match="unknown: vendor_id, product_id") as caught:
        load_profile("lightcommander", device="projector1")
    assert "DLPA024" in caught.value.remedy
    profile = read_file(UsbProfile, Path("drivers/projector/profiles/lightcommander.yaml"), device="p")
    assert not profile.enabled
    assert not any(character.isdigit() for value in profile.model_dump().values() for character in str(value))


def test_a_profile_that_is_complete_but_not_enabled_sends_nothing(tmp_path: Path) -> None:
    text = Path("drivers/projector/profiles/lightcommander-sim.yaml").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("enabled: true", "enabled: false"))
    with pytest.raises(ConfigurationError, match="is disabled"):
        load_profile(str(path), device="projector1")


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("DLP_LED_LEDdriverEnable", "DLP_LED_DriverEnable", "unknown operation"),
        ('{name: "on", type: u8}', '{name: "of", type: u8}', "no parameter 'of'"),
        ("{name: percent, type: f64}", "{name: percent, type: u8}", "percent cannot be u8"),
        ("reply: u8", "reply: text", "cannot reply text"),
        ("checksum: sum", "checksum: none", "checksum part"),
        ("  - {part: status, type: u8}\n", "", "has a status and a length"),
        ("  - {part: payload}\n", "", "has one payload"),
        ("{part: sequence, type: u8}", "{part: sequence}", "a `type`"),
        ("bytes: a5", "bytes: a", "pattern"),
        ("vendor_id: 0xfff0", "vendor_id: 0x1fff0", "vendor_id"),
        ("byte_order: little", "byte_order: litle", "byte_order"),
    ],
)
def test_a_wrong_profile_is_told_with_its_line(tmp_path: Path, old: str, new: str, what: str) -> None:
    text = Path("drivers/projector/profiles/lightcommander-sim.yaml").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigurationError, match=r"mine.yaml:\d+:\d+: ") as caught:
        load_profile(str(path), device="projector1")
    assert what in str(caught.value)


def test_an_unknown_profile_names_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="no USB profile") as caught:
        load_profile("lightcomander", device="projector1")
    assert "'lightcommander'" in caught.value.remedy


# --- compiled sequences

# The head that TI's compiler 1.5.0 writes.
HEAD = """\
#=================================================================
# Configuration Registers/LUTs for DLP LightCommander
#---------------------------------------------------------
#   Created on:  Mon Apr 30 15:32:31 2018
#   Version#:    1.5.0
#
#   Output Attributes:
#   Comment                  = fringes.lcp fringes
#   DMD                      = XGA
#   Mode                     = SL
#   Display Pattern Frm Rate = 60 Hz
#   Exposure Time            = 16660 usec
#   Exposure Time/Frm period = 0.99960
#   Num BPP:                 = 8
#   Num Patterns in Seq      = 1
#   Real-time input source   = false
#   Active LEDs              = RLED  GLED  BLED
#=================================================================
$L2.5 ExecutePassthroughDLPAPI  _DisablePwmSeq
$L2.5 WriteReg 0x1111 0x000000f8   # data byte 000000
"""


def test_the_head_of_a_compiled_sequence() -> None:
    found = parse_sequence_text("projector1", Path("a.bf"), HEAD, infrared_name="IRLED")
    assert (found.exposure_us, found.bits) == (16_660, 8)
    assert found.period_us == pytest.approx(16_666.7, abs=0.1)
    assert found.leds == (Led.RED, Led.GREEN, Led.BLUE)
    named = parse_sequence_text("p", Path("a.bf"), HEAD.replace("RLED  GLED  BLED", "HEAT"), infrared_name="HEAT")
    assert named.leds == (Led.INFRARED,)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("XGA", "WXGA", "DMD = XGA"),
        ("= SL", "= VIDEO", "Mode = SL"),
        ("60 Hz", "sixty Hz", "Frm Rate"),
        ("16660 usec", "-5 usec", "Exposure Time"),
        ("16660 usec", "8330 usec", "contradicts itself"),
        ("0.99960", "nan", "Frm period"),
        ("BPP:                 = 8", "BPP:                 = 9", "9 bits"),
        ("RLED  GLED  BLED", "XLED", "XLED"),
        ("RLED  GLED  BLED", "", "LEDs"),
    ],
)
def test_a_head_that_cannot_be_used(old: str, new: str, what: str) -> None:
    with pytest.raises(ConfigurationError, match=r"a\.bf cannot be used") as caught:
        parse_sequence_text("projector1", Path("a.bf"), HEAD.replace(old, new), infrared_name="IRLED")
    assert what in caught.value.what


@given(st.text(alphabet="#= \nDMDXGASLModeHz019.usec", max_size=200) | st.text(max_size=100))
def test_any_text_is_a_sequence_or_a_typed_error(text: str) -> None:
    with pytest.raises(ConfigurationError):
        parse_sequence_text("projector1", Path("a.bf"), text, infrared_name="IRLED")


def test_a_sequence_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_sequence_file("p", tmp_path / "none.bf", infrared_name="IRLED")
    for content in (b"\xff\xfe", b"#" * (1 << 20) + b"#"):
        (tmp_path / "bad.bf").write_bytes(content)
        with pytest.raises(ConfigurationError, match=r"bad.bf cannot be used"):
            read_sequence_file("p", tmp_path / "bad.bf", infrared_name="IRLED")
