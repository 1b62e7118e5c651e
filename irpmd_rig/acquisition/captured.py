"""What passes between the photographer and whoever wants pictures: settings, frames, errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import Camera, Frame, Led, Projector, Stage, SyncOutput
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.acquisition.patterns import Orientation
from irpmd_rig.core.quality import FrameReport

FrameRole = Literal["fringes", "white", "black", "plain", "switched", "series"]
BurstTrigger = Literal["hardware", "software"]
Images = NDArray[np.uint8] | NDArray[np.uint16]


class Cancelled(AcquisitionError):
    """Taking frames was cancelled."""

    def __init__(self) -> None:
        super().__init__("taking frames was cancelled", "begin it again")

    def __reduce__(self) -> tuple[type[Cancelled], tuple[()]]:
        return type(self), ()


class FrameQuality(AcquisitionError):
    """Frames that came, but are not what they should be: stale, blended, swapped, saturated, too dim.

    Attributes
    ----------
    report
        What the check found, frame by frame.
    """

    def __init__(self, report: FrameReport) -> None:
        super().__init__(
            "; ".join(finding.message for finding in report.findings),
            "check exposure, trigger and placement, then take the frames again",
        )
        self.report = report

    def __reduce__(self) -> tuple[type[FrameQuality], tuple[FrameReport]]:
        return type(self), (self.report,)


class Instruments(Protocol):
    """What the photographer needs of a rig: opened instruments."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    @property
    def projector(self) -> Projector:
        """The projector."""

    @property
    def stages(self) -> Mapping[str, Stage]:
        """Stages by their names in the rig file."""


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """How frames are taken.

    Attributes
    ----------
    led, intensity
        Light of the projector; intensity as a fraction of the LED's full drive.
    pixel_format
        Of the camera.
    levels
        256 levels to show fringes by, each in the place of its index (a characterised gamma); None: as they are.
    retries
        How often a burst, a frame or a fringe measurement is taken again before it has failed.
    frame_timeout_s
        Bound for one frame, from the end of the one before it, or from its trigger.
    sync
        The projector's pulse that triggers the camera.
    """

    led: Led = Led.INFRARED
    intensity: float = 0.6
    pixel_format: str = "Mono8"
    levels: bytes | None = None
    retries: int = 2
    frame_timeout_s: float = 5.0
    sync: SyncOutput = field(default_factory=lambda: SyncOutput(enabled=True))


@dataclass(frozen=True, slots=True, eq=False)
class CapturedFrame:
    """One frame, and what it was taken for.

    Attributes
    ----------
    frame
        The camera's.
    role
        What was shown: fringes, white, black, nothing ("plain"), white a time after black ("switched"), one
        picture for many frames ("series").
    exposure_us, led, intensity
        As they were in force; led None: no light of the projector.
    attempt
        1, or more if it was taken again.
    orientation, counts, steps, set, step
        Of fringes: which pattern of which set this is, counted from 0.
    checks
        Figures of the check, by name.
    """

    frame: Frame
    role: FrameRole
    exposure_us: float
    led: Led | None
    intensity: float
    attempt: int
    orientation: Orientation | None = None
    counts: tuple[float, ...] = ()
    steps: int = 0
    set: int | None = None
    step: int | None = None
    checks: Mapping[str, Any] = field(default_factory=dict)


class FringeFrames(Sequence[CapturedFrame]):
    """The frames of a fringe measurement in order, and the same pixels as one array.

    Attributes
    ----------
    images
        (sets, steps, H, W); each frame's image is a view of it.
    """

    def __init__(self, frames: tuple[CapturedFrame, ...], images: Images) -> None:
        self._frames = frames
        self.images = images

    @overload
    def __getitem__(self, index: int) -> CapturedFrame: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[CapturedFrame, ...]: ...
    def __getitem__(self, index: int | slice) -> CapturedFrame | tuple[CapturedFrame, ...]:
        return self._frames[index]

    def __len__(self) -> int:
        return len(self._frames)

    def __iter__(self) -> Iterator[CapturedFrame]:
        return iter(self._frames)


class FrameStack:
    """Puts the frames of a burst into one array while the next ones are exposed.

    Parameters
    ----------
    shape
        (sets, steps).
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._shape = shape
        self._images: Images | None = None

    def put(self, number: int, frame: Frame) -> Frame:
        """Copy a frame to its place; returns it with that place as its image."""
        if self._images is None:
            self._images = np.empty((self._shape[0] * self._shape[1], *frame.image.shape), frame.image.dtype)
        self._images[number] = frame.image
        place = self._images[number]
        place.flags.writeable = False
        return replace(frame, image=place)

    def images(self) -> Images:
        """All of them, (sets, steps, H, W)."""
        assert self._images is not None
        return self._images.reshape(*self._shape, *self._images.shape[1:])
