from pathlib import Path

import pytest

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
    Refused,
    TimedOut,
    Unsupported,
)
from irpmd_rig.acquisition.conduct import Ending, RunEnded
from irpmd_rig.acquisition.endings import ending_of
from irpmd_rig.acquisition.errors import AcquisitionError
from irpmd_rig.core.errors import FramesError
from irpmd_rig.processing.errors import ComputingLost, ProcessingError
from irpmd_rig.processing.errors import Refused as CalibrationRefused
from irpmd_rig.store.errors import DiskFull
from irpmd_rig.store.states import Reason, RunState


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (DeviceLost, Reason.DEVICE_LOST),
        (NotConnected, Reason.DEVICE_LOST),
        (TimedOut, Reason.DEVICE_TIMEOUT),
        (DeviceFault, Reason.DEVICE_FAULT),
        (GarbledReply, Reason.DEVICE_FAULT),
        (MotionFailed, Reason.MOTION_FAILED),
        (LimitReached, Reason.LIMIT),
        (FramesLost, Reason.FRAMES_LOST),
        (IncompleteFrame, Reason.FRAMES_LOST),
        (Refused, Reason.REFUSED),
        (Unsupported, Reason.REFUSED),
    ],
)
def test_every_instrument_error_has_its_reason(kind: type[InstrumentError], reason: Reason) -> None:
    ending = ending_of(kind("stage1", "it happened", "mend it"))
    assert ending == Ending(RunState.FAILED, reason, "stage1: it happened (mend it)")


def test_other_errors_have_theirs(tmp_path: Path) -> None:
    reasons = {
        FramesError("nothing is lit"): Reason.FRAME_QUALITY,
        AcquisitionError("no such exposure", "give another"): Reason.REFUSED,
        DiskFull(tmp_path, 10, 5): Reason.DISK_FULL,
        ProcessingError("no facets", "look"): Reason.RECONSTRUCTION_FAILED,
        CalibrationRefused("too old", "make another"): Reason.REFUSED,
        ComputingLost("it hung", "retry"): Reason.RECONSTRUCTION_FAILED,
    }
    for error, reason in reasons.items():
        ending = ending_of(error)
        assert (ending.reason, ending.detail) == (reason, str(error))


def test_what_was_wanted_is_told_as_wanted() -> None:
    wanted = Ending(RunState.ABORTED, Reason.ABORTED_BY_USER, "Ada")
    assert ending_of(RunEnded(wanted)) == wanted


def test_a_fault_of_the_program_is_called_one() -> None:
    ending = ending_of(KeyError("missing"))
    assert ending.reason is Reason.REFUSED
    assert "KeyError" in ending.detail
    assert "fault of the program" in ending.detail
