"""What the rig needs of a camera, a projector and a stage, whoever made them.

Rules that hold for every driver:

- A driver class has ``Settings`` (a pydantic model) and is made by ``Class(name, settings)``; `name` is the
  instrument's name in the rig file and stands in every error. Making it touches no device: `open` does.
- Every operation ends within a bound, by its result or by one of the errors of `drivers.errors`. A bound that
  passes is never success.
- `stop` may be called from another thread at any time, also while an operation blocks, and does not wait for
  its end.
- After `close` (or a failed `open`) no process, thread, descriptor or memory of the driver is left. `close`
  never raises and may be repeated; `open` after `close`, or after a device came back, works.
- A value that was not measured is never passed off as measured.
"""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.errors import (
    ConfigurationError,
    DeviceFault,
    DeviceLost,
    FramesLost,
    GarbledReply,
    IncompleteFrame,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    Refused,
    TimedOut,
    Unsupported,
)
from drivers.values import (
    LED_INTENSITY_LIMIT,
    CameraCapabilities,
    CameraCounters,
    CameraSettings,
    Frame,
    Led,
    Node,
    NodeMap,
    PatternSequence,
    PatternTiming,
    Position,
    ProjectorCapabilities,
    ProjectorCondition,
    ProjectorStatus,
    Region,
    StageCapabilities,
    StageCondition,
    StageState,
    StopAnswer,
    SyncOutput,
    TravelLimits,
    Trigger,
    check_intensity,
)

__all__ = [
    "LED_INTENSITY_LIMIT",
    "Camera",
    "CameraCapabilities",
    "CameraCounters",
    "CameraSettings",
    "ConfigurationError",
    "DeviceFault",
    "DeviceLost",
    "Frame",
    "FramesLost",
    "GarbledReply",
    "IncompleteFrame",
    "Instrument",
    "InstrumentError",
    "Led",
    "LimitReached",
    "MotionFailed",
    "Node",
    "NodeMap",
    "NotConnected",
    "PatternSequence",
    "PatternTiming",
    "Position",
    "Projector",
    "ProjectorCapabilities",
    "ProjectorCondition",
    "ProjectorStatus",
    "Refused",
    "Region",
    "Stage",
    "StageCapabilities",
    "StageCondition",
    "StageState",
    "StopAnswer",
    "SyncOutput",
    "TimedOut",
    "TravelLimits",
    "Trigger",
    "Unsupported",
    "check_intensity",
]


@runtime_checkable
class Instrument(Protocol):
    """What every instrument has."""

    @property
    def name(self) -> str:
        """Name in the rig file."""

    def open(self) -> None:
        """Connect and bring the instrument into a known, safe state.

        Raises
        ------
        NotConnected
            It is not there, or may not be used by this user.
        ConfigurationError
            The settings cannot be right, whatever is plugged in.
        """

    def close(self) -> None:
        """Make safe and disconnect; never raises, may be repeated."""

    def stop(self) -> StopAnswer:
        """End what is going on, from any thread, at any time; harmless when nothing is.

        Raises
        ------
        InstrumentError
            The instrument could not be told, so that nobody knows whether it has ended.
        """


@runtime_checkable
class Camera(Instrument, Protocol):
    """A camera that takes frames freely, on a software trigger or on a hardware trigger."""

    def capabilities(self) -> CameraCapabilities:
        """Tell what the opened camera can do."""

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply the settings, set gamma to 1, and tell what the camera really took.

        Raises
        ------
        Unsupported
            The camera has no such setting.
        Refused
            The value is out of range, or frames are being taken.
        """

    def arm(self, frames: int | None = None) -> None:
        """Be ready for `frames` frames (None: until `stop`); returns when the camera would answer a trigger.

        Frames of an earlier arming are discarded: none of them is ever fetched.
        """

    def trigger(self) -> None:
        """Start one exposure (software trigger).

        Raises
        ------
        Refused
            Not armed, or the trigger is not ``"software"``.
        """

    def fetch(self, timeout_s: float) -> Frame:
        """Return the next frame of the armed burst, in order.

        Raises
        ------
        TimedOut
            No frame came within `timeout_s`, and the camera still answers.
        DeviceLost
            The camera is gone.
        IncompleteFrame
            The next frame had parts missing; the one after it can be fetched.
        FramesLost
            A gap in the camera's count.
        Refused
            Not armed, or all frames of the burst were fetched.
        """

    def frames(self, timeout_s: float) -> Iterator[Frame]:
        """Yield the frames of the burst that are left, each within `timeout_s`; raises as `fetch` does."""

    def temperature_c(self) -> float:
        """Temperature in degrees Celsius.

        Raises
        ------
        Unsupported
            The camera does not measure it.
        """

    def counters(self) -> CameraCounters:
        """Tell the count of frames since `open`."""

    def dump(self) -> NodeMap:
        """Read the whole node map, for a first contact with an unknown camera."""


@runtime_checkable
class Projector(Instrument, Protocol):
    """A projector of grey patterns in one chosen light. `open` and `stop` leave it dark."""

    def capabilities(self) -> ProjectorCapabilities:
        """Tell what the opened projector can do."""

    def load(self, patterns: NDArray[np.uint8]) -> None:
        """Replace the loaded patterns by `patterns`, (n, H, W).

        Raises
        ------
        Unsupported
            The box takes no patterns (they live in its flash).
        Refused
            Wrong shape, too many, or a sequence is running.
        """

    def order(self, sequence: PatternSequence) -> PatternSequence:
        """Set the sequence that `step`, `run_once` and `repeat` follow, and tell the times that are in force.

        Raises
        ------
        Refused
            An index that is not loaded, or a time that this projector cannot keep.
        """

    def show(self, index: int) -> None:
        """Show one loaded pattern and leave it on; returns when its light is there."""

    def step(self) -> int | None:
        """Show the next pattern of the order; returns its index, or None after the last (dark then)."""

    def run_once(self) -> None:
        """Start the order once, on the projector's clock; returns when it has started."""

    def repeat(self) -> None:
        """Start the order over and over, until `stop`; returns when it has started."""

    def set_led(self, led: Led, intensity: float) -> None:
        """Light one LED, all others off; 0 is off.

        Raises
        ------
        Refused
            Above `LED_INTENSITY_LIMIT` (`check_intensity`).
        Unsupported
            There is no such LED under software's control.
        """

    def configure_sync(self, sync: SyncOutput) -> None:
        """Set the pulse for the camera.

        Raises
        ------
        Unsupported
            There is no such output.
        """

    def park(self) -> None:
        """Park the mirrors for transport or long rest; dark, LED off."""

    def unpark(self) -> None:
        """Make ready again after `park`."""

    def status(self) -> ProjectorStatus:
        """Tell what the projector is doing."""


@runtime_checkable
class Stage(Instrument, Protocol):
    """One axis of motion, in absolute millimetres."""

    def capabilities(self) -> StageCapabilities:
        """Tell what this axis can do."""

    def home(self) -> Position:
        """Find the axis's own zero; returns when it stands there.

        Raises
        ------
        Unsupported
            It cannot: see `zero`.
        """

    def zero(self, position_mm: float, *, confirmed_by: str) -> Position:
        """Call the present place `position_mm`, on the word of the person `confirmed_by`; nothing moves."""

    def move_to(self, position_mm: float) -> None:
        """Start an absolute move; returns when it has begun, `wait` when it has ended.

        Raises
        ------
        LimitReached
            Outside `limits`; nothing was sent.
        Refused
            Not homed or zeroed since `open` or since the connection was lost; still moving; the controller
            refuses.
        """

    def wait(self, timeout_s: float | None = None) -> Position:
        """Wait for the end of the move, within `timeout_s` or within the axis's own bound for this move.

        Returns at once when nothing moves and the last move succeeded.

        Raises
        ------
        TimedOut
            It still moves.
        MotionFailed
            No progress, stopped by `stop`, or outside the in-position window.
        LimitReached
            A limit switch ended it.
        """

    def position(self) -> Position:
        """Tell where the axis is now.

        Raises
        ------
        Refused
            There is no zero yet.
        """

    def set_speed(self, speed_mm_per_s: float) -> float:
        """Set the speed of later moves; returns the nearest that the controller has, which is now in force.

        Raises
        ------
        Refused
            Outside the range of `capabilities`, or moving.
        Unsupported
            The speed is not under software's control.
        """

    def limits(self) -> TravelLimits:
        """Tell the soft limits."""

    def state(self) -> StageState:
        """Tell what the axis is doing; never raises."""
