"""What a compiled sequence of the LightCommander sets: read from the head of its batch file (.bf).

TI's sequence compiler writes exposure, rate, bits and LEDs as comments above the register writes. No public
call sets them otherwise, so a driver that must know them reads that head.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import ConfigurationError
from drivers.values import Led

LARGEST_FILE_BYTES = 1 << 20
KNOWN_LEDS = {"RLED": Led.RED, "GLED": Led.GREEN, "BLED": Led.BLUE}
# Frame rate, exposure and their ratio are rounded, each in its own way.
CONSISTENT = 0.02

_LINE = re.compile(r"#\s*([^=#]*?)\s*:?\s*=\s*(.*?)\s*$")
_MEND = "compile it again with TI's sequence compiler, or name another file"


@dataclass(frozen=True, slots=True)
class SequenceFile:
    """A batch file and what its head says."""

    path: Path
    text: str
    exposure_us: float
    period_us: float
    bits: int
    leds: tuple[Led, ...]


def read_sequence_file(device: str, path: Path, *, infrared_name: str) -> SequenceFile:
    """Read a batch file.

    Parameters
    ----------
    device
        Name of the projector, for the error.
    path
        The file.
    infrared_name
        How its head names the infrared LED.

    Raises
    ------
    ConfigurationError
        It cannot be read, or its head lacks or contradicts something.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE_BYTES + 1)
        text = content.decode("ascii")
    except OSError as error:
        raise ConfigurationError(
            device, f"the sequence file {path} cannot be read: {error.strerror}", "correct its name", ("sequences",)
        ) from None
    except UnicodeDecodeError:
        raise _wrong(device, path, "it is no text of ASCII characters") from None
    if len(content) > LARGEST_FILE_BYTES:
        raise _wrong(device, path, f"it is larger than {LARGEST_FILE_BYTES} bytes")
    return parse_sequence_text(device, path, text, infrared_name=infrared_name)


def parse_sequence_text(device: str, path: Path, text: str, *, infrared_name: str) -> SequenceFile:
    """Read the head of a batch file's text; raises as `read_sequence_file` does."""
    head = {match[1]: match[2] for line in text.splitlines() if (match := _LINE.match(line))}
    if head.get("DMD") != "XGA":
        raise _wrong(device, path, f"its head does not say 'DMD = XGA' but {head.get('DMD')!r}")
    if head.get("Mode") != "SL":
        raise _wrong(device, path, f"its head does not say 'Mode = SL' (structured light) but {head.get('Mode')!r}")
    rate_hz = _number(device, path, head, "Display Pattern Frm Rate", "Hz")
    exposure_us = _number(device, path, head, "Exposure Time", "usec")
    ratio = _number(device, path, head, "Exposure Time/Frm period", "")
    bits = _number(device, path, head, "Num BPP", "")
    period_us = 1e6 / rate_hz
    if abs(exposure_us / period_us - ratio) > CONSISTENT or exposure_us > period_us * (1 + CONSISTENT):
        raise _wrong(device, path, f"its head contradicts itself: {exposure_us:g} us, {rate_hz:g} Hz, ratio {ratio:g}")
    if bits not in range(1, 9):
        raise _wrong(device, path, f"its head says {bits:g} bits per pixel")
    names = KNOWN_LEDS | {infrared_name: Led.INFRARED}
    leds = head.get("Active LEDs", "").split()
    if not leds or not names.keys() >= set(leds):
        raise _wrong(device, path, f"its head names the LEDs {leds}; known are {sorted(names)}")
    return SequenceFile(path, text, exposure_us, period_us, int(bits), tuple(names[led] for led in leds))


def _number(device: str, path: Path, head: dict[str, str], name: str, unit: str) -> float:
    value = head.get(name, "")
    try:
        number = float(value.removesuffix(unit))
    except ValueError:
        number = math.nan
    if not 0.0 < number < math.inf:
        raise _wrong(device, path, f"its head says {name!r} = {value!r}")
    return number


def _wrong(device: str, path: Path, what: str) -> ConfigurationError:
    return ConfigurationError(device, f"the sequence file {path.name} cannot be used: {what}", _MEND, ("sequences",))
