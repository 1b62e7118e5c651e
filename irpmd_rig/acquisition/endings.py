"""From what went wrong to the reason, from the closed list, for which a run ended."""

from __future__ import annotations

from drivers.protocols import (
    DeviceFault,
    DeviceLost,
    FramesLost,
    GarbledReply,
    IncompleteFrame,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    TimedOut,
)
from irpmd_rig.acquisition.captured import FrameQuality
from irpmd_rig.acquisition.conduct import Ending, RunEnded
from irpmd_rig.acquisition.safety import StopLatched
from irpmd_rig.acquisition.settling import NotSettled
from irpmd_rig.core.errors import FramesError
from irpmd_rig.processing.errors import ProcessingError
from irpmd_rig.store.errors import DiskFull, WriteFailed
from irpmd_rig.store.states import Reason, RunState

# The first that fits.
_REASONS: tuple[tuple[type[BaseException], Reason], ...] = (
    (StopLatched, Reason.STOPPED),
    (DeviceLost, Reason.DEVICE_LOST),
    (NotConnected, Reason.DEVICE_LOST),
    (TimedOut, Reason.DEVICE_TIMEOUT),
    (MotionFailed, Reason.MOTION_FAILED),
    (NotSettled, Reason.MOTION_FAILED),
    (LimitReached, Reason.LIMIT),
    (FramesLost, Reason.FRAMES_LOST),
    (IncompleteFrame, Reason.FRAMES_LOST),
    (DeviceFault, Reason.DEVICE_FAULT),
    (GarbledReply, Reason.DEVICE_FAULT),
    (FrameQuality, Reason.FRAME_QUALITY),
    (FramesError, Reason.FRAME_QUALITY),
    (DiskFull, Reason.DISK_FULL),
    # A disk that refuses for another reason than room: the closed list has no other word for it.
    (WriteFailed, Reason.DISK_FULL),
)


def ending_of(error: BaseException) -> Ending:
    """Say how a run ends in which this was raised.

    What is not listed (an instrument or a rig that cannot do what is asked, a recipe that cannot be read any more, a
    fault of this program) is `refused`, with its own words.
    """
    if isinstance(error, RunEnded):
        return error.ending
    if isinstance(error, ProcessingError):
        return Ending(RunState.FAILED, error.reason, str(error))
    reason = next((reason for kind, reason in _REASONS if isinstance(error, kind)), Reason.REFUSED)
    said = str(error) or type(error).__name__
    if reason is Reason.REFUSED and not _expected(error):
        said = f"{type(error).__name__}: {said} (a fault of the program: see its log)"
    return Ending(RunState.FAILED, reason, said)


def _expected(error: BaseException) -> bool:
    module = type(error).__module__
    return isinstance(error, InstrumentError) or module.startswith("irpmd_rig.")
