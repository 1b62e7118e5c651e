"""The pattern memory of a LightCommander: what lies in it, in which order, and by which sequence it is shown."""

import hashlib
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, Refused
from drivers.projector.bitplanes import COLUMNS, PLANE_BYTES, PLANES, ROWS, pack
from drivers.projector.sequence_file import SequenceFile
from drivers.projector.ti_api import Result, Value
from drivers.values import Led, PatternSequence, PatternTiming

LOAD_BITS = 8
LIMIT = PLANES // LOAD_BITS
# From the command to the light: the time to load the mirrors.
MIRROR_LOAD_S = 230e-6
# Highest pattern rates: of binary patterns, and of 8 bits. Between them nothing is known: the lower one.
HIGHEST_RATE_HZ = {1: 5000.0, 8: 700.0}
# A compiled exposure is never exactly the one that was asked for (16 660 us at 60 Hz).
TOLERANCE = 0.005


class Box(Protocol):
    """Calls one operation of TI's API."""

    def __call__(self, operation: str, **values: Value) -> Result:
        """Carry it out."""


class PatternMemory:
    """A `drivers.projector.source.PatternSource` in the box's own memory.

    Only what changed is sent: planes, order and sequence that are in the box stay there.

    Parameters
    ----------
    device
        Name of the instrument, for errors.
    box
        Calls the box.
    pause
        Waits, unless stopped.
    sequences
        The compiled sequences that may be used.
    """

    size_px = (COLUMNS, ROWS)

    def __init__(
        self, device: str, box: Box, pause: Callable[[float], None], sequences: tuple[SequenceFile, ...]
    ) -> None:
        self._device = device
        self._box = box
        self._pause = pause
        self._sequences = sequences
        self._led: Led | None = None
        self.forget()

    def forget(self) -> None:
        """Know nothing of the box: it was not there, or is another one."""
        self._patterns: NDArray[np.uint8] = np.empty((0, ROWS, COLUMNS), np.uint8)
        self._planes: dict[int, bytes] = {}
        self._bits = LOAD_BITS
        # In how many bits all patterns lie in the box; None: not all of them do.
        self._complete: int | None = None
        self._order: tuple[int, ...] = ()
        self._lut: tuple[int, tuple[int, ...]] | None = None
        self._at: int | None = None
        self._in_force: SequenceFile | None = None
        self._wanted: SequenceFile | None = None
        self._led = None

    @property
    def timings(self) -> tuple[PatternTiming, ...]:
        """The times of the compiled sequences."""
        return tuple(PatternTiming(file.exposure_us, file.period_us, file.bits, file.leds) for file in self._sequences)

    def count(self, _bits: int, /) -> int:
        """Tell how many patterns are loaded."""
        return len(self._patterns)

    def load(self, patterns: NDArray[np.uint8]) -> None:
        """Send the planes that differ from those in the box."""
        self._patterns, self._complete = patterns[:0], None
        self._order, self._wanted = (), None
        self._send(patterns, LOAD_BITS)
        self._patterns = patterns

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Choose the compiled sequence for these times and bits, and bring the planes into its shape.

        Raises
        ------
        Refused
            No sequence file has this exposure, or it is faster than the mirrors can follow.
        """
        if sequence.bits * len(self._patterns) > PLANES:
            raise Refused(self._device, "more bit planes than the memory holds", "load fewer patterns")
        found = self._matching(sequence)
        self._wanted = None
        self._send(self._patterns, sequence.bits)
        self._wanted, self._order = found, sequence.order
        self._use(found)
        self._write_order(sequence.order)
        return PatternSequence(sequence.order, found.exposure_us, found.period_us, sequence.bits)

    def lights(self, led: Led) -> bool:
        """Whether the sequence that was ordered lights this LED."""
        return self._wanted is None or led in self._wanted.leds

    def light(self, led: Led) -> bool:
        """Choose the sequence that lights this LED with the times that were ordered; whether that is another.

        Raises
        ------
        Refused
            No sequence file lights it with these times.
        """
        former, wanted = self._led, self._wanted
        self._led = led
        if wanted is None:
            return former is not led
        for found in (wanted, *self._sequences):
            if led in found.leds and found.bits == wanted.bits and _alike(found, wanted):
                self._wanted = found
                return found is not wanted
        self._led = former
        raise Refused(
            self._device,
            f"no sequence file lights {led} for {wanted.exposure_us:g} us at {wanted.bits} bits",
            "compile one with TI's sequence compiler and name it in `sequences`",
        )

    def show(self, index: int) -> None:
        """Show one pattern by hand."""
        self._begin((index,))

    def show_position(self, position: int) -> None:
        """Show a pattern of the order: by a step from the one before it, where the box stands there."""
        if position and self._at == position - 1 and self._in_force is self._wanted:
            self._box("DLP_Display_DisplayPatternManualStep")
            self._pause(MIRROR_LOAD_S)
        else:
            self._begin(self._order[position:])
        self._at = position

    def run(self, *, repeat: bool) -> None:
        """Start an automatic pass of the order."""
        if self._wanted is None:
            raise Refused(self._device, "there is no order", "set one")
        self._use(self._wanted)
        self._write_order(self._order)
        self._at = None
        self._box(
            "DLP_Display_DisplayPatternAutoStepRepeatForMultiplePasses"
            if repeat
            else "DLP_Display_DisplayPatternAutoStepForSinglePass"
        )

    def dark(self) -> None:
        """End the display."""
        self._at = None
        self._box("DLP_Display_DisplayStop")

    def _begin(self, order: tuple[int, ...]) -> None:
        self._at = None
        self._use(self._wanted or self._any_sequence())
        self._write_order(order)
        self._box("DLP_Display_DisplayPatternManualForceFirstPattern")
        self._pause(MIRROR_LOAD_S)

    def _any_sequence(self) -> SequenceFile:
        """Return a sequence to show single patterns by, before any order was set."""
        for found in self._sequences:
            if found.bits == self._bits and self._led in (None, *found.leds):
                return found
        light = f" in {self._led}" if self._led else ""
        raise Refused(
            self._device,
            f"no sequence file shows {self._bits} bits{light}",
            "compile one with TI's sequence compiler and name it in `sequences`",
        )

    def _send(self, patterns: NDArray[np.uint8], bits: int) -> None:
        if bits == self._complete:
            return
        if bits != self._bits:
            self._lut = None
        self._bits, self._complete = bits, None
        for number, pattern in enumerate(patterns):
            for bit, plane in enumerate(pack(pattern, bits)):
                place, mark = number * bits + bit, hashlib.blake2b(plane, digest_size=16).digest()
                if self._planes.get(place) == mark:
                    continue
                # Until the box has confirmed it, nobody knows what lies there.
                self._planes.pop(place, None)
                self._box(
                    "DLP_Img_DownloadBitplanePatternToExtMem",
                    plane_bytes=plane,
                    byte_count=PLANE_BYTES,
                    plane=place,
                )
                self._planes[place] = mark
        self._complete = bits

    def _write_order(self, order: tuple[int, ...]) -> None:
        if self._lut != (self._bits, order):
            self._lut = None
            self._box("DLP_RegIO_WriteImageOrderLut", bits_per_pixel=self._bits, order=order, count=len(order))
            self._lut = (self._bits, order)

    def _use(self, found: SequenceFile) -> None:
        """Load a compiled sequence, and hold the box to what its head says."""
        if self._in_force is found:
            return
        self._in_force = None
        self._box("RunBatchFile", file=str(found.path), stop_on_error=1)
        bits = self._box("DLP_Status_GetSeqDataBPP")
        exposure_us = self._box("DLP_Status_GetSeqDataExposure")
        if bits != found.bits or not _near(float(exposure_us or 0.0), found.exposure_us):
            raise ConfigurationError(
                self._device,
                f"the head of {found.path.name} says {found.exposure_us:g} us and {found.bits} bits, "
                f"the box {exposure_us} us and {bits} bits",
                "compile the file again; do not edit it",
                ("sequences",),
            )
        self._in_force = found

    def _matching(self, sequence: PatternSequence) -> SequenceFile:
        limit_hz = HIGHEST_RATE_HZ.get(sequence.bits, HIGHEST_RATE_HZ[8])
        period_us = sequence.period_us or sequence.exposure_us
        if 1e6 / period_us > limit_hz * (1 + 1e-6):
            raise Refused(
                self._device,
                f"{1e6 / period_us:.5g} patterns a second at {sequence.bits} bits are too fast for the mirrors",
                f"give a period of at least {1e6 / limit_hz:.5g} us",
            )
        found = [
            file
            for file in self._sequences
            if file.bits == sequence.bits
            and self._led in (None, *file.leds)
            and _near(file.exposure_us, sequence.exposure_us)
            and (sequence.period_us is None or _near(file.period_us, sequence.period_us))
            and 1e6 / file.period_us <= limit_hz * (1 + 1e-6)
        ]
        if not found:
            have = "; ".join(
                f"{file.exposure_us:g} us every {file.period_us:.6g} us at {file.bits} bits, {' '.join(file.leds)}"
                for file in self._sequences
            )
            asked = f"{sequence.exposure_us:g} us at {sequence.bits} bits" + (f" in {self._led}" if self._led else "")
            raise Refused(
                self._device,
                f"no sequence file has {asked}, and no call sets them",
                f"compile one with TI's sequence compiler, or use what there is: {have}",
            )
        return min(found, key=lambda file: file.period_us)


def _near(value: float, wanted: float) -> bool:
    return abs(value - wanted) <= TOLERANCE * wanted


def _alike(one: SequenceFile, other: SequenceFile) -> bool:
    return _near(one.exposure_us, other.exposure_us) and _near(one.period_us, other.period_us)
