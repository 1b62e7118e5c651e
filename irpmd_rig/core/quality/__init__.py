"""Checks of recorded frames: were they taken as they should have been, and if not, which one and why."""

from irpmd_rig.core.quality.check import check_frames
from irpmd_rig.core.quality.report import FindingKind, FrameFinding, FrameReport

__all__ = ["FindingKind", "FrameFinding", "FrameReport", "check_frames"]
