"""Decoding of fringe frames: wrapped and absolute phase, with what its uncertainty needs."""

from irpmd_rig.core.phase.decoding import decode, wrapped_phases
from irpmd_rig.core.phase.response import CameraResponse
from irpmd_rig.core.phase.results import AbsolutePhase, NoiseModel, WrappedPhases

__all__ = ["AbsolutePhase", "CameraResponse", "NoiseModel", "WrappedPhases", "decode", "wrapped_phases"]
