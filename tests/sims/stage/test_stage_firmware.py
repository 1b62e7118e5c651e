"""The three dialects, fed with frames written by hand from their tables."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sims.clock import ManualClock
from sims.stage import Axis, AxisSettings, Gcd0301m, Gcd040101m, Gsc

IDEAL = AxisSettings(counts_per_mm=100, start_mm=100, ringing_um=0, backlash_um=0, noise_um=0)


class Bench:
    """A controller on a table: frames go in one by one, with a pause after each."""

    def __init__(self, make, axes: int = 1, **settings) -> None:
        self.clock = ManualClock()
        self.axes = {address: Axis(IDEAL, self.clock) for address in range(1, axes + 1)}
        self.firmware = make(self.axes, self.clock, **settings)

    def send(self, *frames: bytes, pause_s: float = 0.5) -> list[bytes]:
        answers = []
        for frame in frames:
            answers.append(self.firmware.receive(frame))
            self.clock.advance(pause_s)
        return answers

    def rest(self) -> float:
        self.clock.advance(60)
        return self.axes[1].true_mm


# --- GCD-0301M: ASCII, write-only


def test_ascii_a_move_is_direction_speed_pulses_and_go() -> None:
    bench = Bench(Gcd0301m)
    assert bench.send(b"@1D01\r\n", b"@1SEF\r\n", b"@1P000000FF\r\n", b"@0G\r\n") == [b"", b"", b"", b""]
    assert bench.rest() == pytest.approx(102.55)
    bench.send(b"@1D00\r\n", b"@1P00000064\r\n", b"@0G\r\n")
    assert bench.rest() == pytest.approx(101.55)


def test_ascii_the_speed_code_sets_the_speed() -> None:
    bench = Bench(Gcd0301m, speed_unit_mm_s=0.1)
    bench.send(b"@1D01\r\n", b"@1S0A\r\n", b"@1P00000064\r\n")
    bench.send(b"@0G\r\n", pause_s=0.505)
    assert bench.axes[1].true_mm == pytest.approx(100.5)


def test_ascii_frames_may_arrive_in_pieces() -> None:
    bench = Bench(Gcd0301m)
    bench.send(b"@1D0", b"1\r", b"\n", b"@1P0000", b"0064\r\n", b"@0G\r\n")
    assert bench.rest() == pytest.approx(101.0)


@pytest.mark.parametrize(
    "bad",
    [
        b"@1P000000ff\r\n",
        b"@1P0000FF\r\n",
        b"@1P000000FF\n",
        b"1P000000FF\r\n",
        b"@2P000000FF\r\n",
        b"@1P000000FF \r\n",
        b"\xff\xfe@1P000000FF\r\n",
    ],
)
def test_ascii_a_frame_that_is_not_exactly_right_is_ignored(bad: bytes) -> None:
    bench = Bench(Gcd0301m)
    bench.send(b"@1D01\r\n", bad, b"\r\n", b"@0G\r\n")
    assert bench.rest() == 100.0


def test_ascii_go_without_pulses_and_undocumented_go_do_nothing() -> None:
    bench = Bench(Gcd0301m)
    bench.send(b"@0G\r\n", b"@1P00000064\r\n", b"@1G\r\n")
    assert bench.rest() == 100.0


def test_ascii_frames_that_come_too_fast_are_lost() -> None:
    bench = Bench(Gcd0301m)
    bench.send(b"@1D01\r\n", b"@1P00000064\r\n", b"@0G\r\n", pause_s=0.01)
    assert bench.rest() == 100.0


def test_ascii_go_starts_all_axes_that_were_given_pulses() -> None:
    bench = Bench(Gcd0301m, axes=2)
    bench.send(b"@1D01\r\n", b"@2D01\r\n", b"@1P00000064\r\n", b"@2P000000C8\r\n", b"@0G\r\n")
    bench.rest()
    assert [axis.true_mm for axis in bench.axes.values()] == pytest.approx([101.0, 102.0])


# --- GCD040101M: binary, write-only

FORWARD = bytes.fromhex("00 00 40 01 44 00 01 00 00 00")
BACKWARD = bytes.fromhex("00 00 40 01 44 00 00 00 00 00")
SPEED_5 = bytes.fromhex("00 00 40 01 53 00 05 00 00 00")
PULSES_5120 = bytes.fromhex("00 00 40 01 50 00 00 14 00 00")
GO = bytes.fromhex("00 00 40 01 47 00 00 00 00 00")


def test_binary_a_move_is_direction_speed_pulses_and_go() -> None:
    bench = Bench(Gcd040101m)
    assert bench.send(FORWARD, SPEED_5, PULSES_5120, GO) == [b"", b"", b"", b""]
    assert bench.rest() == pytest.approx(151.2)
    bench.send(BACKWARD, PULSES_5120, GO)
    assert bench.rest() == pytest.approx(100.0)


def test_binary_the_byte_order_of_the_pulses_is_a_setting() -> None:
    bench = Bench(Gcd040101m, pulse_byte_order="big")
    bench.send(FORWARD, bytes.fromhex("00 00 40 01 50 00 00 00 00 64"), GO)
    assert bench.rest() == pytest.approx(101.0)


def test_binary_finds_the_next_frame_after_garbage_and_forgets_a_torn_one() -> None:
    bench = Bench(Gcd040101m)
    bench.send(b"\x12\x00\x00" + FORWARD, PULSES_5120[:6])
    bench.clock.advance(1)
    bench.send(PULSES_5120, GO)
    assert bench.rest() == pytest.approx(151.2)


@pytest.mark.parametrize(
    "bad",
    [
        "00 00 40 02 50 00 00 14 00 00",
        "00 00 40 01 50 01 00 14 00 00",
        "00 00 40 01 51 00 00 14 00 00",
        "00 01 40 01 50 00 00 14 00 00",
    ],
)
def test_binary_a_frame_of_another_shape_is_ignored(bad: str) -> None:
    bench = Bench(Gcd040101m)
    bench.send(FORWARD, bytes.fromhex(bad), GO)
    assert bench.rest() == 100.0


def test_binary_frames_that_come_too_fast_are_lost() -> None:
    bench = Bench(Gcd040101m)
    bench.send(FORWARD + PULSES_5120 + GO)
    assert bench.rest() == 100.0


# --- GSC-01: every command is answered


def test_gsc_a_relative_move_is_prepared_and_started() -> None:
    bench = Bench(Gsc)
    assert bench.send(b"M:1+P1000\r\n", b"G:\r\n") == [b"OK\r\n", b"OK\r\n"]
    assert bench.send(b"!:\r\n", pause_s=0) == [b"B\r\n"]
    assert bench.rest() == pytest.approx(110.0)
    assert bench.send(b"!:\r\n", b"Q:\r\n") == [b"R\r\n", b"      1000,K,K,R\r\n"]


def test_gsc_an_absolute_move_goes_to_a_count() -> None:
    bench = Bench(Gsc)
    bench.send(b"A:1-P500\r\n", b"G:\r\n")
    assert bench.rest() == pytest.approx(95.0)
    assert bench.send(b"Q:\r\n") == [b"-      500,K,K,R\r\n"]


def test_gsc_the_logical_zero_is_here_after_r() -> None:
    bench = Bench(Gsc)
    bench.send(b"M:1+P1000\r\n", b"G:\r\n")
    bench.rest()
    assert bench.send(b"R:1\r\n", b"Q:\r\n") == [b"OK\r\n", b"         0,K,K,R\r\n"]
    bench.send(b"A:1+P100\r\n", b"G:\r\n")
    assert bench.rest() == pytest.approx(111.0)


def test_gsc_homing_finds_the_origin_and_zeroes_the_counter() -> None:
    bench = Bench(Gsc)
    assert bench.send(b"H:1\r\n") == [b"OK\r\n"]
    assert bench.send(b"M:1+P1\r\n") == [b"NG\r\n"]
    assert bench.rest() == pytest.approx(0.0)
    assert bench.send(b"Q:\r\n") == [b"         0,X,K,R\r\n"]


def test_gsc_stops_with_and_without_deceleration() -> None:
    bench = Bench(Gsc)
    bench.send(b"D:1S100F1000R1000\r\n", b"M:1+P5000\r\n")
    bench.send(b"G:\r\n", pause_s=2)
    assert bench.send(b"L:1\r\n", b"!:\r\n", pause_s=0.1) == [b"OK\r\n", b"B\r\n"]
    decelerated = bench.rest()
    bench.send(b"M:1+P5000\r\n")
    bench.send(b"G:\r\n", pause_s=2)
    assert bench.send(b"L:E\r\n", b"!:\r\n", pause_s=0) == [b"OK\r\n", b"R\r\n"]
    assert decelerated - 100 > bench.rest() - decelerated


def test_gsc_a_limit_switch_is_reported() -> None:
    bench = Bench(Gsc)
    bench.send(b"M:1+P30000\r\n", b"G:\r\n")
    assert bench.rest() == pytest.approx(300.0)
    assert bench.send(b"Q:\r\n") == [b"     20000,K,L,R\r\n"]


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"G:",
        b"M:1P1000",
        b"M:2+P1000",
        b"M:1+P99999999",
        b"M:1+P-5",
        b"m:1+P10",
        b"Q:1",
        b"D:1S50F5000R200",
        b"D:1S5000F500R200",
        b"D:1S500F5000R1001",
        b"H:E",
        b"\xff\xfe\xfd",
    ],
)
def test_gsc_refuses_what_it_does_not_know(bad: bytes) -> None:
    bench = Bench(Gsc)
    answer = b"NG\r\n" if bad else b""
    assert bench.send(bad + b"\r\n", b"Q:\r\n") == [
        answer,
        b"         0,X,K,R\r\n" if bad else b"         0,K,K,R\r\n",
    ]


def test_gsc_answers_every_command_of_one_write_and_joins_pieces() -> None:
    bench = Bench(Gsc)
    assert bench.send(b"!:\r\n!:\r\nQ", b":\r", b"\n") == [b"R\r\nR\r\n", b"", b"         0,K,K,R\r\n"]


def test_gsc_a_busy_axis_takes_only_stops_and_questions() -> None:
    bench = Bench(Gsc)
    bench.send(b"M:1+P10000\r\n", b"G:\r\n")
    refused = bench.send(b"M:1+P1\r\n", b"A:1+P1\r\n", b"G:\r\n", b"R:1\r\n", b"H:1\r\n", pause_s=0)
    assert refused == [b"NG\r\n"] * 5
    assert bench.send(b"L:E\r\n") == [b"OK\r\n"]


def test_gsc_two_axes_are_told_apart_by_their_digit() -> None:
    bench = Bench(Gsc, axes=2)
    bench.send(b"M:2-P300\r\n", b"G:\r\n")
    bench.rest()
    assert bench.send(b"Q:\r\n") == [b"         0,-      300,K,K,R\r\n"]
    bench.send(b"A:W+P100+P200\r\n", b"G:\r\n")
    bench.rest()
    assert [axis.true_mm for axis in bench.axes.values()] == pytest.approx([101.0, 102.0])
    bench.send(b"M:2+P90000\r\n", b"G:\r\n")
    bench.rest()
    assert bench.send(b"Q:\r\n")[0].endswith(b",K,M,R\r\n")


def test_gsc_a_stall_stays_busy_without_progress() -> None:
    bench = Bench(Gsc)
    bench.axes[1].faults.stall_fraction = 0.5
    bench.send(b"M:1+P1000\r\n", b"G:\r\n")
    bench.rest()
    assert bench.send(b"Q:\r\n") == [b"       500,K,K,B\r\n"]


# --- all of them


@pytest.mark.parametrize("make", [Gcd0301m, Gcd040101m, Gsc])
@given(chunks=st.lists(st.binary(max_size=64), max_size=8))
def test_garbage_neither_breaks_nor_moves_a_controller(make, chunks: list[bytes]) -> None:
    bench = Bench(make)
    bench.send(*chunks)
    if not any(chunk.strip(b"\r\n") for chunk in chunks):
        assert bench.rest() == 100.0
