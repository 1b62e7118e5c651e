"""Where the stage really stands, by the glass seen directly in the same frames."""

from __future__ import annotations

import numpy as np

from irpmd_rig.core.calibration.rig_calibration import GLASS, REGIONS, RigView
from irpmd_rig.core.calibration.self_cells import condense
from irpmd_rig.core.calibration.self_inflation import correlation_excess
from irpmd_rig.core.calibration.self_paths import modelled_phase
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import RigModel

_STEP_MM = 1e-2
_ROUNDS = 5
_HUBER = 3.0


def stage_offset(model: RigModel, view: RigView) -> tuple[float, float]:
    """What to add to the stage's reading, along its axis.

    Parameters
    ----------
    model : RigModel
        The calibrated rig.
    view : RigView
        Phase, and where the glass is seen directly; its other regions are not looked at.

    Returns
    -------
    offset_mm, sigma_mm : float
        Estimate, and one sigma from the phase's noise, inflated for neighbouring residuals that hang together.

    Raises
    ------
    CalibrationError
        If the glass is not seen directly: at positions away from it the camera sees too little of it.

    Notes
    -----
    The stage's own noise of 1 um becomes negligible so (physics notes, section 5).
    """
    cells = condense([view])
    cells = cells.of((cells.region == REGIONS.index(GLASS)) & (cells.axis == 0))
    if len(cells) == 0:
        raise CalibrationError(
            f"too few pixels show the glass directly at {view.stage1_mm:g} mm: its position cannot be refined there"
        )
    rays = rays_at(model.intrinsics, cells.pixel)

    def phase(offset_mm: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return modelled_phase(model, cells, rays, np.full(len(cells), view.stage1_mm + offset_mm))

    slope = (phase(_STEP_MM) - phase(-_STEP_MM)) / (2 * _STEP_MM) / cells.sigma_rad
    offset = 0.0
    for _ in range(_ROUNDS):
        residual = (cells.phase_rad - phase(offset)) / cells.sigma_rad
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
        weight = np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(residual), 1e-300))
        offset += float(np.sum(weight * slope * residual) / np.sum(weight * slope**2))
    residual = (cells.phase_rad - phase(offset)) / cells.sigma_rad
    inflation = correlation_excess(cells, residual * np.sqrt(weight), 1.0)
    return offset, float(np.sqrt(inflation / np.sum(weight * slope**2)))
