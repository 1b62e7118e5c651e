"""Light paths of the self-calibration: from a camera ray over mirror and glass to the phase that it shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.rig_calibration import GLASS, MIRROR, REGIONS, SPRAYED
from irpmd_rig.core.calibration.self_cells import Cells
from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]
_UPSIDE_DOWN = np.array([1.0, 1.0, -1.0])


def lit_points(model: RigModel, cells: Cells, rays: Array, stage_mm: Array) -> Array:
    """Points that the projector lights for each cell, (n, 3), in M at s = 0.

    Parameters
    ----------
    model : RigModel
        The rig.
    cells : Cells
        Which region each ray meets.
    rays : ndarray, (n, 3)
        Undistorted rays of the camera.
    stage_mm : ndarray, (n,)
        Stage position of each cell, its offset included.
    """
    directions = model.frame.directions(rays)
    origin = np.broadcast_to(model.frame.camera_mm, directions.shape)
    on_mirror = origin - (origin[:, 2] / directions[:, 2])[:, None] * directions
    direct, reflected = (cells.region == REGIONS.index(name) for name in (GLASS, MIRROR))
    points = np.where(direct[:, None], origin, on_mirror) + stage_mm[:, None] * model.stage_axis
    onward = np.where(reflected[:, None], directions * _UPSIDE_DOWN, directions)
    return np.where((direct | reflected)[:, None], model.meet_glass(points, onward), points)


def phase_at(model: RigModel, cells: Cells, points_mm: Array) -> Array:
    """Phase, (n,), rad, that the projector gives each cell's point (n, 3)."""
    along_y = cells.axis == 1
    phase = model.phase_rad(points_mm, on_glass=False)
    if along_y.any():
        phase = np.where(along_y, model.phase_y_rad(points_mm), phase)
    if model.correction_rad is not None:
        # The sprayed mirror is lit past the glass.
        on_glass = ~along_y & (cells.region != REGIONS.index(SPRAYED))
        phase = phase + on_glass * model.correction_rad(points_mm[:, 0], points_mm[:, 1])
    return phase


def modelled_phase(model: RigModel, cells: Cells, rays: Array, stage_mm: Array) -> Array:
    """Phase, (n,), rad, that the model gives each cell; parameters as for `lit_points`."""
    return phase_at(model, cells, lit_points(model, cells, rays, stage_mm))
