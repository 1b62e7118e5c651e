"""Frozen values that pass between a driver and whoever uses it; units are in the names."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.errors import Refused

LED_INTENSITY_LIMIT = 0.60
"""Highest intensity of any LED, as a fraction of its full drive (DLP LightCommander, erratum E0031)."""


@dataclass(frozen=True, slots=True)
class StopAnswer:
    """What `stop` achieved.

    Attributes
    ----------
    stopped
        True: nothing moves, exposes or runs any more. False: software cannot stop this instrument.
    ends_in_s
        0 when stopped, else the seconds after which it is expected to have ended by itself.
    """

    stopped: bool
    ends_in_s: float = 0.0


Trigger = Literal["free", "software", "hardware"]


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of the sensor, in pixels from its upper left corner."""

    column_px: int
    row_px: int
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a camera is set to.

    Attributes
    ----------
    exposure_us, gain_db
        Exposure time and analogue gain; None: what the camera has.
    pixel_format
        Name in the GenICam pixel format naming convention: ``"Mono8"``, ``"Mono10"``, ``"Mono10p"``, ...;
        None: what the camera has.
    region
        Part of the sensor that is read; None: all of it.
    frame_rate_hz
        Rate while free-running; None: as fast as it goes.
    trigger
        What starts an exposure.
    """

    exposure_us: float | None = None
    gain_db: float | None = None
    pixel_format: str | None = None
    region: Region | None = None
    frame_rate_hz: float | None = None
    trigger: Trigger = "free"


@dataclass(frozen=True, slots=True)
class CameraCapabilities:
    """What an opened camera can do; a range or size that the camera does not tell is None.

    Attributes
    ----------
    sensor_size_px
        (width, height).
    unverified
        One line for each thing that is assumed about this model and was never checked on one.
    """

    vendor: str
    model: str
    serial_number: str
    sensor_size_px: tuple[int, int]
    pixel_formats: tuple[str, ...]
    triggers: tuple[Trigger, ...]
    exposure_range_us: tuple[float, float] | None
    gain_range_db: tuple[float, float] | None
    frame_rate_range_hz: tuple[float, float] | None
    has_region: bool
    has_temperature: bool
    unverified: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One complete frame.

    Attributes
    ----------
    image
        uint8 or uint16, (H, W), or (H, W, channels) of a colour camera; line padding stripped, packing
        undone, read-only. It belongs to the caller: later frames never change it.
    bits
        Significant bits of a value: full scale is 2**bits - 1.
    index
        0, 1, 2, ... since `arm`: the position in the burst.
    frame_id
        The camera's own count, whatever it starts from; a gap in it is a lost frame.
    timestamp_s
        The camera's clock (its own zero); None where it has none.
    received_s
        `time.monotonic()` of the computer when the frame was complete.
    exposure_us
        As the camera reported it at `configure`; None where it cannot tell.
    """

    image: NDArray[np.uint8] | NDArray[np.uint16]
    bits: int
    index: int
    frame_id: int
    timestamp_s: float | None
    received_s: float
    exposure_us: float | None


@dataclass(frozen=True, slots=True)
class CameraCounters:
    """Frames since `open`: passed on, dropped as incomplete, lost before they reached the driver."""

    delivered: int
    incomplete: int
    lost: int


@dataclass(frozen=True, slots=True)
class Node:
    """One node of a camera's node map; value None: it could not be read, and `access` says why."""

    name: str
    kind: str
    access: str
    value: str | None


@dataclass(frozen=True, slots=True)
class NodeMap:
    """What a camera tells about itself: its description file (None: it has none) and its nodes."""

    xml: bytes | None
    nodes: tuple[Node, ...]


class Led(StrEnum):
    """The projector's light."""

    RED = "red"
    GREEN = "green"
    BLUE = "blue"
    INFRARED = "infrared"


def check_intensity(device: str, intensity: float) -> float:
    """Pass an LED intensity on, if it may be set.

    Parameters
    ----------
    device
        Name of the projector, for the error.
    intensity
        Fraction of the full drive.

    Raises
    ------
    Refused
        Not a number between 0 and `LED_INTENSITY_LIMIT`.
    """
    if not 0.0 <= intensity <= LED_INTENSITY_LIMIT:
        raise Refused(
            device,
            f"an LED intensity of {intensity:g} is refused",
            f"give 0 to {LED_INTENSITY_LIMIT:g}: more may damage the projector (erratum E0031)",
        )
    return intensity


@dataclass(frozen=True, slots=True)
class PatternSequence:
    """The order in which loaded patterns are shown, and for how long.

    Attributes
    ----------
    order
        Indices of loaded patterns; repeats are allowed.
    exposure_us
        Time that each is lit.
    period_us
        Time from one pattern to the next; None: the shortest that this exposure allows.
    bits
        Bits per pixel that are shown, 1 to 8.
    """

    order: tuple[int, ...]
    exposure_us: float
    period_us: float | None = None
    bits: int = 8


@dataclass(frozen=True, slots=True)
class SyncOutput:
    """A pulse for the camera at the start of each pattern."""

    enabled: bool
    output: int = 1
    polarity: Literal["positive", "negative"] = "positive"
    delay_us: float = 0.0
    width_us: float = 100.0


@dataclass(frozen=True, slots=True)
class PatternTiming:
    """One pair of times that `PatternSequence` may ask for, at so many bits and in these lights."""

    exposure_us: float
    period_us: float
    bits: int
    leds: tuple[Led, ...]


@dataclass(frozen=True, slots=True)
class ProjectorCapabilities:
    """What an opened projector can do; None: not known or not limited.

    Attributes
    ----------
    size_px
        (width, height) of a pattern.
    leds
        Lights that `set_led` takes; empty where the light is not under software's control.
    can_load
        False: patterns live in the box (flash), and `load` is Unsupported.
    self_paced
        True: `run_once` and `repeat` run on the projector's own clock with sync pulses.
    timings
        The only times that `order` takes; None: it takes any that it can keep.
    unverified
        One line for each thing that is assumed about this model and was never checked on one.
    """

    model: str
    size_px: tuple[int, int]
    leds: tuple[Led, ...]
    pattern_limit: int | None
    can_load: bool
    self_paced: bool
    has_sync: bool
    can_park: bool
    unverified: tuple[str, ...] = ()
    timings: tuple[PatternTiming, ...] | None = None


class ProjectorCondition(StrEnum):
    """What a projector is doing."""

    CLOSED = "closed"
    DARK = "dark"
    SHOWING = "showing"
    RUNNING = "running"
    PARKED = "parked"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class ProjectorStatus:
    """State of a projector; None: this model does not tell."""

    condition: ProjectorCondition
    pattern_index: int | None
    led: Led | None
    intensity: float | None
    temperature_c: float | None
    faults: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Position:
    """Where a stage is.

    Attributes
    ----------
    position_mm
        In the axis of the rig file (its sign and zero).
    measured
        True: the controller said so. False: computed from what was commanded.
    """

    position_mm: float
    measured: bool


@dataclass(frozen=True, slots=True)
class TravelLimits:
    """Soft limits of an axis: no target outside is ever sent."""

    lower_mm: float
    upper_mm: float


@dataclass(frozen=True, slots=True)
class StageCapabilities:
    """What an axis can do.

    Attributes
    ----------
    speed_range_mm_per_s
        Slowest and fastest speed; None where the speed is not under software's control.
    can_home
        It finds its own zero. If not, `zero` takes one that a person confirmed.
    can_stop
        Software can end a move. If not, `stop` answers when it will have ended.
    reads_position, reads_limits
        Positions are measured; limit switches are reported.
    unverified
        One line for each fact about this box that was never checked on one, with how to check it.
    """

    model: str
    speed_range_mm_per_s: tuple[float, float] | None
    can_home: bool
    can_stop: bool
    reads_position: bool
    reads_limits: bool
    unverified: tuple[str, ...] = ()


class StageCondition(StrEnum):
    """What an axis is doing."""

    CLOSED = "closed"
    NO_ZERO = "no_zero"
    READY = "ready"
    MOVING = "moving"
    AT_LIMIT = "at_limit"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class StageState:
    """State of an axis.

    Attributes
    ----------
    condition
        NO_ZERO: open, but neither homed nor zeroed since it was opened or came back. FAILED: the last move
        did not end where it should; the next one may be tried. LOST: the port went away.
    position
        None while there is no zero.
    target_mm
        Where the present or last move goes; None before the first.
    """

    condition: StageCondition
    position: Position | None
    target_mm: float | None
    speed_mm_per_s: float | None
