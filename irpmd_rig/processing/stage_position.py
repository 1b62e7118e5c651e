"""Where stage 1 stood while frames were taken: as it read, or as the glass in these frames shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.rig_calibration import RigView
from irpmd_rig.core.calibration.rig_stage_offset import stage_offset
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.frames import FringeStation
from irpmd_rig.processing.glass import glass_mask
from irpmd_rig.processing.phases import StationPhase
from irpmd_rig.processing.regions import shrink

# What a stage of this class is accurate to (the paper: 1 um) where the glass does not tell where it stood.
SIGMA_POSITION_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class StagePosition:
    """Where stage 1 stood.

    Attributes
    ----------
    read_mm
        As the stage told it.
    used_mm, sigma_mm
        What is taken for true, with one sigma.
    measured
        Whether that was found from the glass in the same frames.
    """

    read_mm: float
    used_mm: float
    sigma_mm: float
    measured: bool


def stage_position(
    station: FringeStation, phase: StationPhase, rig: tuple[RigModel, NDArray[np.float64]] | None
) -> StagePosition:
    """Find where the stage stood by the glass that is seen directly, if there is enough of it.

    Parameters
    ----------
    station, phase
        The frames.
    rig
        The calibrated rig and the outline of its glass (`irpmd_rig.processing.glass`); None: not known.
    """
    read_mm = station.stage1_mm
    as_read = StagePosition(read_mm, read_mm, SIGMA_POSITION_MM, measured=False)
    if rig is None:
        return as_read
    model, outline_mm = rig
    nothing = np.zeros(phase.phase_rad.shape, np.bool_)
    glass = shrink(glass_mask(model, outline_mm, read_mm))
    view = RigView(read_mm, phase.phase_rad, phase.sigma_rad, nothing, nothing, glass)
    try:
        offset_mm, sigma_mm = stage_offset(model, view)
    except CalibrationError:
        return as_read
    return StagePosition(read_mm, read_mm + offset_mm, sigma_mm, measured=True)
