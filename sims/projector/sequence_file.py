"""Compiled sequences as the simulated LightCommander reads them: what sets exposure, rate, bits and LEDs.

TI's compiler writes batch files (.bf): a head of comments that says what is in them, then register writes,
most of them words of SEQ_LUT written to register 0x1111. What those words mean is not public. The layout of
the file follows a published one; THE WORDS ARE INVENTED for the simulation and mean nothing to a real box,
and a real file's words mean nothing to the simulated one. The words alone decide what the simulated box does;
it never reads the comments.

`python -m sims.projector.sequence_file --exposure-us 40000 --bits 8 --led infrared > sim.bf` writes such a
file.
"""

import argparse
import re
import sys
from collections.abc import Sequence as Words
from dataclasses import dataclass

LEDS = ("red", "green", "blue", "infrared")
# How the head of a file names them; the name of the infrared one is a guess, no published file lights it.
LED_NAMES = dict(zip(LEDS, ("RLED", "GLED", "BLED", "IRLED"), strict=True))
SEQ_LUT_REGISTER = 0x1111
INVENTED_MARK = 0x51AC0DE5
WORDS = 7
TICK_US = 0.1
# Shortest periods: 5000 Hz of binary patterns, 700 Hz of 8 bits. Between them nothing is known: a straight
# line.
SHORTEST_1_BIT_US, SHORTEST_8_BITS_US = 200.0, 1e6 / 700


@dataclass(frozen=True, slots=True)
class Sequence:
    """What a sequence sets; times are kept to 0.1 us."""

    exposure_us: float
    period_us: float
    bits: int
    leds: tuple[str, ...]
    patterns: int = 1


def shortest_period_us(bits: int) -> float:
    """Return the shortest frame period for patterns of 1 to 8 bits."""
    return SHORTEST_1_BIT_US + (SHORTEST_8_BITS_US - SHORTEST_1_BIT_US) * (bits - 1) / 7


def encode(sequence: Sequence) -> list[int]:
    """Return the invented SEQ_LUT words of a sequence."""
    words = [
        INVENTED_MARK,
        round(sequence.exposure_us / TICK_US),
        round(sequence.period_us / TICK_US),
        sequence.bits,
        sum(1 << LEDS.index(led) for led in sequence.leds),
        sequence.patterns,
    ]
    return [*words, sum(words) & 0xFFFFFFFF]


def decode(words: Words[int]) -> Sequence | None:
    """Return the sequence that invented SEQ_LUT words describe, or None if they are not such words."""
    if len(words) != WORDS or words[0] != INVENTED_MARK or sum(words[:-1]) & 0xFFFFFFFF != words[-1]:
        return None
    _, exposure, period, bits, mask, patterns, _ = words
    if not 1 <= bits <= 8 or not 0 < exposure <= period or mask >> len(LEDS) or not patterns:
        return None
    leds = tuple(led for number, led in enumerate(LEDS) if mask >> number & 1)
    return Sequence(exposure * TICK_US, period * TICK_US, bits, leds, patterns)


def batch_file(sequence: Sequence) -> str:
    """Return a sequence as the text of a batch file."""
    names = "  ".join(LED_NAMES[led] for led in sequence.leds)
    lines = [
        "#=================================================================",
        "# Configuration Registers/LUTs for DLP LightCommander",
        "# SIMULATED: the SEQ_LUT words are invented, never send them to a real box",
        "#",
        "#   Output Attributes:",
        "#   DMD                      = XGA",
        "#   Mode                     = SL",
        f"#   Display Pattern Frm Rate = {1e6 / sequence.period_us:g} Hz",
        f"#   Exposure Time            = {sequence.exposure_us:g} usec",
        f"#   Exposure Time/Frm period = {sequence.exposure_us / sequence.period_us:.5f}",
        f"#   Num BPP:                 = {sequence.bits}",
        f"#   Num Patterns in Seq      = {sequence.patterns}",
        "#   Real-time input source   = false",
        f"#   Active LEDs              = {names}",
        "#=================================================================",
        "$L2.5 ExecutePassthroughDLPAPI  _DisablePwmSeq",
        "$L2.5 DLP_RegIO_BeginLUTdata   SEQ_LUT",
        *(
            f"$L2.5 WriteReg 0x{SEQ_LUT_REGISTER:04x} 0x{word:08x}   # data byte {4 * place:06x}"
            for place, word in enumerate(encode(sequence))
        ),
        "$L2.5 DLP_RegIO_EndLUTdata  SEQ_LUT",
        "$L2.5 ExecutePassthroughDLPAPI  _EnablePwmSeq",
    ]
    return "\n".join(lines) + "\n"


STEP = re.compile(
    r"\$L2\.5\s+(?:"
    r"WriteReg\s+(?P<register>\w+)\s+(?P<value>\w+)"
    r"|DLP_RegIO_(?P<lut>Begin|End)LUTdata\s+SEQ_LUT"
    r"|ExecutePassthroughDLPAPI\s+_(?:Disable|Enable)PwmSeq)"
)


def batch_steps(text: str) -> list[tuple[str, int, int]] | None:
    """Return the steps of a batch file, or None if a line is none.

    They are ("WriteReg", register, value), ("Begin", 0, 0) and ("End", 0, 0).
    """
    steps = []
    for line in text.splitlines():
        code = line.split("#")[0].strip()
        if not code:
            continue
        match = STEP.fullmatch(code)
        if match is None:
            return None
        if match["lut"]:
            steps.append((match["lut"], 0, 0))
        elif match["register"]:
            try:
                steps.append(("WriteReg", int(match["register"], 0), int(match["value"], 0)))
            except ValueError:
                return None
    return steps


def main() -> None:
    """Write a batch file for the simulated box."""
    parser = argparse.ArgumentParser(description="a sequence file for the simulated LightCommander")
    parser.add_argument("--exposure-us", type=float, required=True)
    parser.add_argument("--period-us", type=float, help="frame period; the exposure, if not given")
    parser.add_argument("--bits", type=int, choices=range(1, 9), default=8)
    parser.add_argument("--led", choices=LEDS, action="append", required=True)
    chosen = parser.parse_args()
    period_us = max(chosen.period_us or chosen.exposure_us, shortest_period_us(chosen.bits))
    sequence = Sequence(chosen.exposure_us, period_us, chosen.bits, tuple(chosen.led))
    sys.stdout.write(batch_file(sequence))


if __name__ == "__main__":
    main()
