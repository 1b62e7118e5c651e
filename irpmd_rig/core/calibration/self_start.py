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
        gives: a phase is a ratio of two linear forms of the lit point. Its principal point is put on the picture's
        middle column: a transformation that knows no lens blames the lens's distortion on it.

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
    # Fringes along x leave open where the projector is along its rows (opposite the middle of what is lit), and what
    # its rows are.
    along, rows, centre_y = row @ points_mm.mean(axis=0), focal, (nominal.size_px[1] - 1) / 2
    if upright is not None:
        rows = float(upright.numerator[:3] @ row)
        centre_y = float(upright.numerator[:3] @ view)
        along = -(upright.numerator[3] - centre_y * upright.denominator[3]) / rows
    aside = -(across.numerator[3] - principal * across.denominator[3]) / focal
    start = np.array([aside, along, -across.denominator[3]])
    middle = (nominal.size_px[0] - 1) / 2
    centre = np.stack([column, row, view]).T @ start
    return Projector(
        nominal.size_px,
        _turned(column, row, view, (middle - principal) / focal),
        centre,
        (focal, rows),
        (middle, centre_y),
    )


def _turned(column: Array, row: Array, view: Array, slope: float) -> Array:
    """Axes that look along what lay by this slope beside the view."""
    cosine, sine = np.array([1.0, slope]) / np.hypot(1.0, slope)
    return np.stack([cosine * column - sine * view, row, cosine * view + sine * column])
