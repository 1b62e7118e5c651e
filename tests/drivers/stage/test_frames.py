"""Frames are compared with bytes written by hand from the documented tables, never from a dialect file."""

import contextlib
import functools
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, GarbledReply, Refused
from drivers.stage.dialect import Command, Dialect, Replies
from drivers.stage.dialect import load_dialect as load_uncached
from drivers.stage.frames import (
    Encoder,
    ReplyReader,
    Status,
    Values,
    read_acknowledge,
    read_busy,
    read_status,
)

EXAMPLES = int(os.environ.get("IRPMD_PARSER_EXAMPLES", "300"))


# Reading a file for each example would take most of the time.
@functools.cache
def load_dialect(name: str) -> Dialect:
    return load_uncached(name, device="stage1")


def encoder(dialect: str, byte_order: str | None = None) -> Encoder:
    return Encoder("stage1", load_dialect(dialect), byte_order)


def move_frames(dialect: str, values: Values, byte_order: str | None = None) -> list[bytes]:
    writer = encoder(dialect, byte_order)
    return [writer.encode(command, values) for command in writer.dialect.actions.move]


def replies() -> Replies:
    found = load_dialect("gsc").replies
    assert found is not None
    return found


def test_gcd_0301m_sends_direction_speed_pulses_and_go() -> None:
    assert move_frames("gcd-0301m", Values(axis=1, counts=255, speed=0xEF)) == [
        b"@1D01\r\n",
        b"@1SEF\r\n",
        b"@1P000000FF\r\n",
        b"@0G\r\n",
    ]


def test_gcd_0301m_moves_back_with_direction_00() -> None:
    assert move_frames("gcd-0301m", Values(axis=2, counts=-0x12AB34CD, speed=1)) == [
        b"@2D00\r\n",
        b"@2S01\r\n",
        b"@2P12AB34CD\r\n",
        b"@0G\r\n",
    ]


def test_gcd_040101m_sends_ten_bytes_a_command() -> None:
    assert move_frames("gcd-040101m", Values(axis=1, counts=0x1400, speed=5), "little") == [
        bytes([0x00, 0x00, 0x40, 0x01, 0x44, 0x00, 0x01, 0x00, 0x00, 0x00]),
        bytes([0x00, 0x00, 0x40, 0x01, 0x53, 0x00, 0x05, 0x00, 0x00, 0x00]),
        bytes([0x00, 0x00, 0x40, 0x01, 0x50, 0x00, 0x00, 0x14, 0x00, 0x00]),
        bytes([0x00, 0x00, 0x40, 0x01, 0x47, 0x00, 0x00, 0x00, 0x00, 0x00]),
    ]


def test_gcd_040101m_writes_the_same_documented_frame_for_other_counts_in_the_other_byte_order() -> None:
    documented = bytes([0x00, 0x00, 0x40, 0x02, 0x50, 0x00, 0x00, 0x14, 0x00, 0x00])
    assert move_frames("gcd-040101m", Values(axis=2, counts=0x00001400, speed=5), "little")[2] == documented
    assert move_frames("gcd-040101m", Values(axis=2, counts=0x00140000, speed=5), "big")[2] == documented
    assert move_frames("gcd-040101m", Values(axis=2, counts=-5, speed=5), "big")[0][6] == 0


def test_gcd_040101m_writes_nothing_while_the_byte_order_is_unknown() -> None:
    with pytest.raises(ConfigurationError, match="byte order"):
        move_frames("gcd-040101m", Values(axis=1, counts=1, speed=5))


def test_gsc_moves_absolutely_with_sign_and_plain_digits() -> None:
    assert move_frames("gsc", Values(axis=1, counts=1000)) == [b"A:1+P1000\r\n", b"G:\r\n"]
    assert move_frames("gsc", Values(axis=1, counts=-500)) == [b"A:1-P500\r\n", b"G:\r\n"]
    assert move_frames("gsc", Values(axis=1, counts=0)) == [b"A:1+P0\r\n", b"G:\r\n"]


def test_gsc_other_commands_are_as_documented() -> None:
    writer = encoder("gsc")
    actions = writer.dialect.actions

    def frames(commands: tuple[Command, ...] | None) -> list[bytes]:
        return [writer.encode(command, Values(1, speed=5000)) for command in commands or ()]

    assert frames(actions.home) == [b"H:1\r\n"]
    assert frames(actions.stop) == [b"L:E\r\n"]
    assert frames(actions.zero) == [b"R:1\r\n"]
    assert frames(actions.set_speed) == [b"D:1S500F5000R200\r\n"]
    assert actions.status is not None
    assert frames((actions.status,)) == [b"Q:\r\n"]
    assert actions.busy is not None
    assert frames((actions.busy,)) == [b"!:\r\n"]


def test_a_value_that_does_not_fit_its_field_is_refused() -> None:
    with pytest.raises(Refused, match="too large"):
        move_frames("gcd-0301m", Values(axis=1, counts=2**32, speed=1))
    with pytest.raises(Refused, match="too large"):
        move_frames("gsc", Values(axis=1, counts=16_777_216))


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (b"1000,K,K,R", Status(1000, busy=False, at_limit=False)),
        (b"-      1000,K,K,B", Status(-1000, busy=True, at_limit=False)),
        (b"+20,X,L,R", Status(20, busy=False, at_limit=True)),
        (b"         0,K,K,R", None),
        (b" 0,K,K,R", None),
    ],
)
def test_gsc_status_is_read_as_documented(answer: bytes, status: Status | None) -> None:
    expected = status or Status(0, busy=False, at_limit=False)
    assert read_status("stage1", replies(), answer) == expected


@pytest.mark.parametrize("answer", [b"", b"OK", b"1000,K,K", b"1000,K,K,RR", b"1e3,K,K,R", b"\xff0,K,K,R", b"-,K,K,R"])
def test_an_unknown_status_is_garbled(answer: bytes) -> None:
    with pytest.raises(GarbledReply):
        read_status("stage1", replies(), answer)


def test_no_is_refused_and_anything_but_yes_is_garbled() -> None:
    read_acknowledge("stage1", replies(), b"OK", b"G:\r\n")
    with pytest.raises(Refused, match="G:"):
        read_acknowledge("stage1", replies(), b"NG", b"G:\r\n")
    with pytest.raises(GarbledReply):
        read_acknowledge("stage1", replies(), b"O", b"G:\r\n")


LIKELY = st.sampled_from(
    [b"OK", b"NG", b"\r\n", b"\r", b"\n", b",", b"K", b"L", b"B", b"R", b"-", b"1", b" ", b"\x00", b"\xff"]
)
PIECES = st.lists(st.one_of(st.binary(max_size=80), LIKELY), max_size=40)


@settings(max_examples=EXAMPLES, deadline=None)
@given(PIECES)
def test_any_bytes_in_any_pieces_end_in_an_answer_or_a_typed_error(pieces: list[bytes]) -> None:
    reader = ReplyReader("stage1", replies())
    for piece in pieces:
        try:
            answer = reader.feed(piece)
        except GarbledReply:
            return
        if answer is not None:
            assert b"\r\n" not in answer
            break
        assert len(reader.gathered) <= 64


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.one_of(st.binary(max_size=64), st.lists(LIKELY, max_size=12).map(b"".join)))
def test_any_answer_is_understood_or_a_typed_error(answer: bytes) -> None:
    for read in (
        lambda: read_status("stage1", replies(), answer),
        lambda: read_busy("stage1", replies(), answer),
        lambda: read_acknowledge("stage1", replies(), answer, b"G:\r\n"),
    ):
        with contextlib.suppress(GarbledReply, Refused):
            read()


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.integers(-(2**24), 2**24), st.sampled_from("BR"), st.sampled_from("KL"), st.integers(1, 10))
def test_a_status_cut_anywhere_is_read_whole(counts: int, busy: str, limit: str, cut: int) -> None:
    sent = f"{'-' if counts < 0 else '+'}{abs(counts):>9},K,{limit},{busy}\r\n".encode()
    reader = ReplyReader("stage1", replies())
    answers = [reader.feed(sent[at : at + cut]) for at in range(0, len(sent), cut)]
    assert answers[:-1] == [None] * (len(answers) - 1)
    assert answers[-1] is not None
    assert read_status("stage1", replies(), answers[-1]) == Status(counts, busy == "B", limit == "L")
