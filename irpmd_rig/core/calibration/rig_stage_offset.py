"""Where the stage really stands, by the glass seen directly in the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.rig_calibration import GLASS, REGIONS, RigView
from irpmd_rig.core.calibration.self_cells import Cells, condense
from irpmd_rig.core.calibration.self_inflation import correlation_excess
from irpmd_rig.core.calibration.self_paths import modelled_phase
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]

_STEP_MM = 1e-2
_ROUNDS = 5
_HUBER = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class StageOffset:
    """What to add to the stage's reading, along its axis.

    Attributes
    ----------
    offset_mm, sigma_mm : float
        Estimate, and one sigma from the phase's noise, inflated for neighbouring residuals that hang together.
    cells : Cells
        The glass by which it was found.
    pull_mm_per_rad : ndarray, (n,)
        By how much the phase of each cell pulls the offset.
    phase_rad : ndarray, (n,)
        What the model shows each cell at this offset.
    stage1_mm : float
        Position, offset included.
    """

    offset_mm: float
    sigma_mm: float
    cells: Cells
    pull_mm_per_rad: Array
    phase_rad: Array
    stage1_mm: float

    def shifts_mm(self, variations: Sequence[RigModel]) -> Array:
        """What other rigs, near the model, would make of the offset less what the model makes: (k,), linear."""
        stage_mm = np.full(len(self.cells), self.stage1_mm)
        shifts = []
        for other in variations:
            phase = modelled_phase(other, self.cells, rays_at(other.intrinsics, self.cells.pixel), stage_mm)
            shifts.append(float(self.pull_mm_per_rad @ (self.phase_rad - phase)))
        return np.array(shifts)


def stage_offset(model: RigModel, view: RigView) -> StageOffset:
    """Offset of the stage's position from its reading.

    Parameters
    ----------
    model : RigModel
        The calibrated rig.
    view : RigView
        Phase, and where the glass is seen directly; its other regions are not looked at.

    Raises
    ------
    CalibrationError
        If the glass is not seen directly: at positions away from it the camera sees too little of it.

    Notes
    -----
    The stage's own noise of 1 um becomes negligible so (physics notes, section 5). What the calibration does not know
    of the rig moves the offset, too: a result's covariance has to take its variations together with their
    `StageOffset.shifts_mm`.
    """
    cells = condense([view])
    cells = cells.of((cells.region == REGIONS.index(GLASS)) & (cells.axis == 0))
    if len(cells) == 0:
        raise CalibrationError(
            f"too few pixels show the glass directly at {view.stage1_mm:g} mm: its position cannot be refined there"
        )
    rays = rays_at(model.intrinsics, cells.pixel)

    def phase(offset_mm: float) -> Array:
        return modelled_phase(model, cells, rays, np.full(len(cells), view.stage1_mm + offset_mm))

    slope = (phase(_STEP_MM) - phase(-_STEP_MM)) / (2 * _STEP_MM) / cells.sigma_rad
    offset = 0.0
    for _ in range(_ROUNDS):
        residual = (cells.phase_rad - phase(offset)) / cells.sigma_rad
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
        weight = np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(residual), 1e-300))
        offset += float(np.sum(weight * slope * residual) / np.sum(weight * slope**2))
    shown = phase(offset)
    residual = (cells.phase_rad - shown) / cells.sigma_rad
    inflation = correlation_excess(cells, residual * np.sqrt(weight), 1.0)
    information = float(np.sum(weight * slope**2))
    return StageOffset(
        offset_mm=offset,
        sigma_mm=float(np.sqrt(inflation / information)),
        cells=cells,
        pull_mm_per_rad=weight * slope / cells.sigma_rad / information,
        phase_rad=shown,
        stage1_mm=view.stage1_mm + offset,
    )
