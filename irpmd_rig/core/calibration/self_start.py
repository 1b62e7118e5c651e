"""First guess of a self-calibration: the projector from points whose places the paper's calibration knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.geometry import RigGeometry
from irpmd_rig.core.calibration.rig_calibration import NominalProjector
from irpmd_rig.core.calibration.self_cells import Cells
from irpmd_rig.core.calibration.self_paths import lit_points
from irpmd_rig.core.camera import Intrinsics, rays_at
from irpmd_rig.core.errors import CalibrationError
from irpmd_rig.core.rig_model import Projector, RigModel

Array = NDArray[np.float64]


def first_guess(
    cells: Cells, stage_mm: Array, intrinsics: Intrinsics, geometry: RigGeometry, nominal: NominalProjector
) -> RigModel:
    """A rig near the true one.

    Parameters
    ----------
    cells : Cells
        All that was measured.
    stage_mm : ndarray, (views,)
        Stage positions; the geometry was taken at the first.
    intrinsics : Intrinsics
        The camera's.
    geometry : RigGeometry
        Mirror and glass as the white plate shows them.
    nominal : NominalProjector
        Size and count.

    Returns
    -------
    RigModel
        Stage along the normal, glass as in the geometry, and the projector that a direct linear transformation
        gives: a phase is a ratio of two linear forms of the lit point.

    Raises
    ------
    CalibrationError
        If the lit points do not tell a projector.
    """
    axis = np.array([0.0, 0.0, -1.0])
    normal, offset = geometry.frame.plane(geometry.glass)
    offset += float(stage_mm[0] * (normal @ axis))
    glass = (float(-normal[0] / normal[2]), float(-normal[1] / normal[2]), float(offset / normal[2]))
    nowhere = Projector(nominal.size_px, np.eye(3), np.zeros(3), (1.0, 1.0), (0.0, 0.0))
    model = RigModel(intrinsics, geometry.frame, glass, axis, nowhere, nominal.count)
    points = lit_points(model, cells, rays_at(intrinsics, cells.pixel), stage_mm[cells.view])
    turns = cells.phase_rad / (2 * np.pi * nominal.count)
    forms = [
        _ratio(points[along], turns[along] * size - 0.5) if along.any() else None
        for along, size in zip((cells.axis == 0, cells.axis == 1), nominal.size_px, strict=True)
    ]
    return RigModel(intrinsics, geometry.frame, glass, axis, _projector(forms, points, nominal), nominal.count)


@dataclass(frozen=True, slots=True)
class _Ratio:
    """coordinate = numerator . (X, 1) / denominator . (X, 1); the denominator is the distance along the view."""

    numerator: Array
    denominator: Array


def _ratio(points_mm: Array, pixel: Array) -> _Ratio:
    """Direct linear transformation of one coordinate."""
    middle, size = points_mm.mean(axis=0), points_mm.std()
    centre, width = pixel.mean(), pixel.std()
    scaled = np.concatenate([(points_mm - middle) / size, np.ones((len(points_mm), 1))], axis=1)
    value = (pixel - centre) / width
    rows = np.concatenate([scaled, -value[:, None] * scaled], axis=1)
    _, singular, vectors = np.linalg.svd(rows.T @ rows)
    numerator, denominator = vectors[-1, :4], vectors[-1, 4:]
    back = np.eye(4)
    back[:3, :3] /= size
    back[:3, 3] = -middle / size
    denominator = denominator @ back
    numerator = width * (numerator @ back) + centre * denominator
    length = np.linalg.norm(denominator[:3])
    ahead = denominator[:3] @ middle + denominator[3]
    if singular[-2] < 1e-12 * singular[0] or length == 0 or ahead == 0:
        raise CalibrationError(
            "glass and sprayed mirror do not tell where the projector is: both must be lit and seen, at two or more "
            "stage positions"
        )
    scale = np.sign(ahead) / length
    return _Ratio(numerator * scale, denominator * scale)


def _projector(forms: list[_Ratio | None], points_mm: Array, nominal: NominalProjector) -> Projector:
    across, upright = forms
    assert across is not None  # the phase along x is always there
    view = across.denominator[:3]
    principal = float(across.numerator[:3] @ view)
    column = across.numerator[:3] - principal * view
    focal = float(np.linalg.norm(column))
    column = column / focal
    row = np.cross(view, column)
    if upright is not None and upright.numerator[:3] @ row < 0:
        row = -row  # a mirrored picture
    axes = np.stack([column, row, view])
    # Fringes along x leave the place along the rows open: opposite the middle of what is lit.
    along = row @ points_mm.mean(axis=0)
    if upright is not None:
        slope = upright.numerator[:3] @ row
        shift = float(upright.numerator[:3] @ view)
        along = -(upright.numerator[3] - shift * upright.denominator[3]) / slope
    start = np.array([-(across.numerator[3] - principal * across.denominator[3]) / focal, along, -view_offset(across)])
    centre_y = (nominal.size_px[1] - 1) / 2 if upright is None else shift
    return Projector(nominal.size_px, axes, axes.T @ start, (focal, focal), (principal, centre_y))


def view_offset(form: _Ratio) -> float:
    """Constant of the distance along the view."""
    return float(form.denominator[3])
