"""Where stage 1 stood while frames were taken: as it read, or as the glass in these frames shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.rig_calibration import RigView
from irpmd_rig.core.calibration.rig_stage_offset import StageOffset, stage_offset
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.frames import FringeStation
from irpmd_rig.processing.glass import glass_mask
from irpmd_rig.processing.regions import Mask, grow, shrink

if TYPE_CHECKING:
    from irpmd_rig.processing.phases import StationPhase

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
    by_glass
        How it was found from the glass in the same frames; None: it is what was read.
    """

    read_mm: float
    used_mm: float
    sigma_mm: float
    by_glass: StageOffset | None

    @property
    def measured(self) -> bool:
        """Whether it was found from the glass in the same frames."""
        return self.by_glass is not None

    def shifts_mm(self, variations: Sequence[RigModel]) -> NDArray[np.float64]:
        """By how much other rigs would move what is taken for true, (k,)."""
        return np.zeros(len(variations)) if self.by_glass is None else self.by_glass.shifts_mm(variations)


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
    if rig is None:
        return StagePosition(station.stage1_mm, station.stage1_mm, SIGMA_POSITION_MM, None)
    return _by_glass(station, phase, rig[0], glass_mask(*rig, station.stage1_mm))


@dataclass(frozen=True, slots=True, eq=False)
class GlassSeen:
    """What the glass in a station's frames tells.

    Attributes
    ----------
    position
        Where the stage stood.
    hidden
        Pixels that show the glass itself or stand at its rim, (H, W).
    """

    position: StagePosition
    hidden: Mask


def glass_seen(
    station: FringeStation, phase: StationPhase, model: RigModel, outline_mm: NDArray[np.float64]
) -> GlassSeen:
    """Find the glass in a station's frames, and by it the stage's position: see `stage_position`."""
    glass = glass_mask(model, outline_mm, station.stage1_mm)
    return GlassSeen(_by_glass(station, phase, model, glass), grow(glass))


def _by_glass(station: FringeStation, phase: StationPhase, model: RigModel, glass: Mask) -> StagePosition:
    read_mm = station.stage1_mm
    nothing = np.zeros(glass.shape, np.bool_)
    view = RigView(read_mm, phase.phase_rad, phase.sigma_rad, nothing, nothing, shrink(glass))
    try:
        found = stage_offset(model, view)
    except CalibrationError:
        return StagePosition(read_mm, read_mm, SIGMA_POSITION_MM, None)
    return StagePosition(read_mm, read_mm + found.offset_mm, found.sigma_mm, found)
