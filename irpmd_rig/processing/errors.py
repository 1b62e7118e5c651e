"""What can go wrong between a run folder and its results."""

from __future__ import annotations

from irpmd_rig.store.states import Reason


class ProcessingError(Exception):
    """A run folder that cannot be turned into results.

    Parameters
    ----------
    what
        What was wrong.
    remedy
        What to do about it.
    reason
        Why a run that needs these results ends.
    """

    reason: Reason = Reason.RECONSTRUCTION_FAILED

    def __init__(self, what: str, remedy: str, *, reason: Reason | None = None) -> None:
        super().__init__(what, remedy)
        self.what = what
        self.remedy = remedy
        if reason is not None:
            self.reason = reason

    def __str__(self) -> str:
        return f"{self.what}; {self.remedy}"


class Refused(ProcessingError):
    """A calibration or reference that may not be used for this run."""

    reason = Reason.REFUSED


class FramesUnusable(ProcessingError):
    """Frames that are missing, differ among themselves or fail their checks."""

    reason = Reason.FRAME_QUALITY


class ComputingLost(ProcessingError):
    """The computing process ended or hung and was replaced; the frames are untouched."""
