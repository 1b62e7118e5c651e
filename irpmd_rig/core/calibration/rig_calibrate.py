"""Self-calibration of the rig: a bundle adjustment on reflections, spray and glass at several stage positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.arguments import checked_number
from irpmd_rig.core.calibration.geometry import RigGeometry
from irpmd_rig.core.calibration.intrinsics import CameraCalibration, Checkerboard
from irpmd_rig.core.calibration.rig_calibration import (
    GLASS,
    MIRROR,
    REGIONS,
    SPRAYED,
    NominalProjector,
    RigCalibration,
    RigView,
)
from irpmd_rig.core.calibration.self_cells import Cells, condense
from irpmd_rig.core.calibration.self_fit import Fit, fit_unknowns, weighted_squares
from irpmd_rig.core.calibration.self_freeform import freeform_over
from irpmd_rig.core.calibration.self_paths import lit_points
from irpmd_rig.core.calibration.self_prior import intrinsics_covariance
from irpmd_rig.core.calibration.self_result import result_of
from irpmd_rig.core.calibration.self_start import first_guess
from irpmd_rig.core.calibration.self_unknowns import STOOD_FOR, Unknowns, unknowns_about
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import CalibrationError, FramesError

Array = NDArray[np.float64]

STAGE_SIGMA_MM = 1e-3
_LEAST_TRAVEL_MM = 1.0
# Free-form terms are tried where chi2 is above the first, and kept if the squares fall by so many times the mean one
# for every coefficient: ripples of the pattern, which they cannot describe, raise chi2 too.
_SUSPICIOUS = 1.15
_GAIN = 10.0
# From here on a fit of few cells need not be made one of all, and a fit that did not end is none.
_HOPELESS = 3.0
# What the first steps, from far off, are made with.
_FEW_CELLS = 2000
_ROUGH_ROUNDS = 40


def calibrate_rig(
    views: Sequence[RigView],
    camera: CameraCalibration,
    geometry: RigGeometry,
    projector: NominalProjector,
    *,
    board: Checkerboard | None = None,
    stage_sigma_mm: float = STAGE_SIGMA_MM,
) -> RigCalibration:
    """Camera, glass, stage axis and projector from what the rig's own fringes show.

    Parameters
    ----------
    views : sequence of RigView
        The reference mirror at two or more stage positions; the first is where `geometry` was taken. The longer the
        way between them, the better.
    camera : CameraCalibration
        From the checkerboard; its intrinsics and their covariance are what the fit starts from.
    geometry : RigGeometry
        Mirror and glass by the paper's calibration: the first guess, and the drawing of frame M.
    projector : NominalProjector
        Size of its picture, and count of the fringes.
    board : Checkerboard, optional
        The one of the camera calibration; the paper's by default.
    stage_sigma_mm : float
        Accuracy of a stage position. The stage's scale is taken for right: it makes the millimetre.

    Returns
    -------
    RigCalibration
        In frame M of `irpmd_rig.core.frame.reference_frame`: the mirror is z = 0.

    Raises
    ------
    FramesError
        If maps and masks differ in size.
    CalibrationError
        If the views cannot determine the rig: positions all equal, mirror, spray or glass not seen, or a fit that
        does not settle.

    Notes
    -----
    About 30 numbers from the mean phases of some ten thousand cells (physics notes, section 5). Free-form terms, a
    bow of the glass and a correction of the phase along x over it, are added where the residuals ask for them. A spray
    whose phases do not fit those of glass and mirror is left out, and said (`RigCalibration.undetermined`).
    """
    checked_number("stage_sigma_mm", stage_sigma_mm, zero=False)
    _check(views, camera)
    cells = condense(views)
    read_mm = np.array([float(view.stage1_mm) for view in views])
    _check_seen(cells, read_mm)
    guess = first_guess(cells, read_mm, camera.intrinsics, geometry, projector)
    points = lit_points(guess, cells, rays_at(camera.intrinsics, cells.pixel), read_mm[cells.view])
    aim_mm = points[cells.region != REGIONS.index(SPRAYED)].mean(axis=0)
    prior = intrinsics_covariance(camera, board or Checkerboard())
    unknowns = unknowns_about(guess, aim_mm, prior, np.full(len(views), stage_sigma_mm))
    found = _found(cells, read_mm[cells.view], unknowns)
    # Numbers that fringes hardly tell may creep along for ever; chi2 says whether what is left matters.
    if not found.fit.settled and found.fit.chi2_per_dof > _HOPELESS:
        raise CalibrationError(
            "the self-calibration does not settle: check that mirror, spray and glass are marked rightly, and that the "
            "stage positions belong to the pictures"
        )
    return result_of(found.cells, read_mm, found.unknowns, found.fit, found.spray_chi2)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """An estimate and the cells that it describes; if the spray is not among them, what it is off from the whole."""

    cells: Cells
    unknowns: Unknowns
    fit: Fit
    spray_chi2: float | None = None


def _found(cells: Cells, stage_mm: Array, unknowns: Unknowns) -> _Found:
    """Fit of the rig's numbers; with free-form terms, or without the spray, where the residuals ask for it."""
    near = _near(cells, stage_mm, unknowns)
    whole = _fitted(cells, stage_mm, unknowns, near)
    if whole.chi2_per_dof < _SUSPICIOUS:
        return _Found(cells, unknowns, whole)
    squares = weighted_squares(cells, stage_mm, unknowns, whole.values)
    sprayed = cells.region == REGIONS.index(SPRAYED)
    spray_chi2, glass_chi2 = float(squares[sprayed].mean()), float(squares[~sprayed].mean())
    # The spray is lit past the glass by another part of the projector's picture, and may be marked or lit wrongly: what
    # its light lacks of the model is not what the glass's lacks. Only cells of both fits are compared.
    glass, glass_mm = cells.of(~sprayed), stage_mm[~sprayed]
    bare = _fitted(glass, glass_mm, unknowns, whole.values)
    # The free-form correction is one of the phase along x.
    along_x = glass.axis == 0
    lit, lit_mm = glass.of(along_x), glass_mm[along_x]
    bare_chi2 = float(weighted_squares(lit, lit_mm, unknowns, bare.values).mean())
    fuller, flexible = _with_freeform(lit, lit_mm, unknowns, bare.values)
    if _explained(bare_chi2, flexible, len(fuller) - len(unknowns)):
        return _Found(lit, fuller, flexible, spray_chi2)
    if _explained(glass_chi2, bare, len(STOOD_FOR)):
        bare = fit_unknowns(glass, glass_mm, unknowns, bare.values)
        return _Found(glass, unknowns, bare, spray_chi2)
    return _Found(cells, unknowns, fit_unknowns(cells, stage_mm, unknowns, whole.values))


def _near(cells: Cells, stage_mm: Array, unknowns: Unknowns) -> Array:
    """Values from which a fit goes straight.

    Principal point and distortion of the projector's lens are told apart by little: together they lead a fit that is
    still far off along a curved valley.
    """
    few = _few(cells)
    centred = unknowns.holding(("projector.cx",), unknowns.start)
    return fit_unknowns(cells.of(few), stage_mm[few], centred, unknowns.start, _ROUGH_ROUNDS).values


def _fitted(cells: Cells, stage_mm: Array, unknowns: Unknowns, values: Array) -> Fit:
    """Fit of all cells, or of few if these show already that the numbers do not describe them."""
    few = _few(cells)
    rough = fit_unknowns(cells.of(few), stage_mm[few], unknowns, values, _ROUGH_ROUNDS)
    return rough if rough.chi2_per_dof >= _HOPELESS else fit_unknowns(cells, stage_mm, unknowns, rough.values)


def _few(cells: Cells) -> NDArray[np.bool_]:
    return np.asarray(np.arange(len(cells)) % max(1, len(cells) // _FEW_CELLS) == 0)


def _with_freeform(cells: Cells, stage_mm: Array, unknowns: Unknowns, found: Array) -> tuple[Unknowns, Fit]:
    """Fit of glass and mirror alone, with free-form terms."""
    few = _few(cells)
    model = unknowns.model(found)
    points = lit_points(model, cells, rays_at(model.intrinsics, cells.pixel), stage_mm)
    fuller = unknowns.with_freeform(freeform_over(points), found)
    begin = np.concatenate([found, np.zeros(len(fuller) - len(unknowns))])
    rough = fit_unknowns(cells.of(few), stage_mm[few], fuller, begin)
    return fuller, fit_unknowns(cells, stage_mm, fuller, rough.values)


def _explained(before: float, after: Fit, numbers: int) -> bool:
    """Whether chi2 fell by more on these cells than so many numbers of any kind would make it."""
    left = after.chi2_per_dof
    return (before - left) * len(after.residual) > _GAIN * left * numbers


def _check(views: Sequence[RigView], camera: CameraCalibration) -> None:
    width, height = camera.intrinsics.size_px
    for view in views:
        shapes = {np.shape(one) for one in (view.phase_rad, view.mirror, view.sprayed, view.glass)}
        shapes |= {np.shape(one) for one in (view.phase_y_rad, view.sigma_rad) if isinstance(one, np.ndarray)}
        if shapes != {(height, width)}:
            raise FramesError(
                f"phase and masks of the view at {view.stage1_mm:g} mm must be {(height, width)}, as the camera's "
                f"picture, not {sorted(shapes)}"
            )
    positions = [float(view.stage1_mm) for view in views]
    if len(positions) < 2 or np.ptp(positions) < _LEAST_TRAVEL_MM:
        raise CalibrationError(
            f"the rig was seen at stage positions {positions} mm: add one that is tens of millimetres away, or "
            "distances cannot be known"
        )


def _check_seen(cells: Cells, read_mm: Array) -> None:
    needed = {MIRROR: "the glass's reflection in the mirror", SPRAYED: "the sprayed mirror", GLASS: "the glass itself"}
    for name, what in needed.items():
        seen = np.unique(read_mm[cells.view[cells.region == REGIONS.index(name)]])
        if len(seen) == 0:
            raise CalibrationError(f"too few pixels show {what}: check that it is in view, lit, and marked in a view")
        if name == MIRROR and np.ptp(seen) < _LEAST_TRAVEL_MM:
            raise CalibrationError(
                f"{what} is seen at one stage position only, {seen[0]:g} mm: add positions at which it is seen"
            )
