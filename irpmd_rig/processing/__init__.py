"""A run folder in, results out: the hand-over from frames to the core, in a process of its own.

`Worker` computes in that process; `irpmd_rig.processing.process` does the same here, and loads what it takes.
"""

from irpmd_rig.processing.errors import ComputingLost, FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.link import Worker
from irpmd_rig.processing.values import Announce, ProcessedRun, Progress

__all__ = [
    "Announce",
    "ComputingLost",
    "FramesUnusable",
    "ProcessedRun",
    "ProcessingError",
    "Progress",
    "Refused",
    "Worker",
]
