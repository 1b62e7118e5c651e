"""Self-calibration of the rig: a bundle adjustment on reflections, spray and glass at several stage positions."""

from __future__ import annotations

from collections.abc import Sequence

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
from irpmd_rig.core.calibration.self_fit import Fit, fit_unknowns
from irpmd_rig.core.calibration.self_freeform import freeform_over
from irpmd_rig.core.calibration.self_paths import lit_points
from irpmd_rig.core.calibration.self_prior import intrinsics_covariance
from irpmd_rig.core.calibration.self_result import result_of
from irpmd_rig.core.calibration.self_start import first_guess
from irpmd_rig.core.calibration.self_unknowns import Unknowns, unknowns_about
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.errors import CalibrationError, FramesError

Array = NDArray[np.float64]

STAGE_SIGMA_MM = 1e-3
_LEAST_TRAVEL_MM = 1.0
# Free-form terms are tried where chi2 is above the first, and kept if the squares fall by so many times the mean one
# for every coefficient: ripples of the pattern, which they cannot describe, raise chi2 too.
_SUSPICIOUS = 1.15
_GAIN = 10.0
# From here on the rig's numbers alone need not be fitted to the end, and a fit that did not end is none.
_HOPELESS = 3.0
# What the first steps, from far off, are made with.
_FEW_CELLS = 2000
_ROUGH_ROUNDS = 25


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
        Its data sheet.
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
    bow of the glass and a correction of the phase over it, are added where the residuals ask for them.
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
    unknowns = unknowns_about(guess, aim_mm, projector, prior, np.full(len(views), stage_sigma_mm))
    stage_mm = read_mm[cells.view]
    unknowns, fit = _fitted(cells, stage_mm, unknowns)
    used = cells if unknowns.freeform is None else cells.of(cells.region != REGIONS.index(SPRAYED))
    return result_of(used, read_mm, unknowns, fit)


def _fitted(cells: Cells, stage_mm: Array, unknowns: Unknowns) -> tuple[Unknowns, Fit]:
    """Fit of the rig's numbers, with free-form terms where the residuals ask for them."""
    few = np.arange(len(cells)) % max(1, len(cells) // _FEW_CELLS) == 0
    rough = fit_unknowns(cells.of(few), stage_mm[few], unknowns, unknowns.start, _ROUGH_ROUNDS)
    plain = None
    if rough.chi2_per_dof < _HOPELESS:
        plain = fit_unknowns(cells, stage_mm, unknowns, rough.values)
        if plain.chi2_per_dof < _SUSPICIOUS:
            return unknowns, plain
    fuller, flexible = _with_freeform(cells, stage_mm, unknowns, (plain or rough).values)
    # Numbers that fringes hardly tell may creep along for ever; chi2 says whether what is left matters.
    if plain is not None and not _worth_it(plain, flexible):
        return unknowns, plain
    if not flexible.settled and flexible.chi2_per_dof > _HOPELESS:
        raise CalibrationError(
            "the self-calibration does not settle: check that mirror, spray and glass are marked rightly, and that the "
            "stage positions belong to the pictures"
        )
    return fuller, flexible


def _with_freeform(cells: Cells, stage_mm: Array, unknowns: Unknowns, found: Array) -> tuple[Unknowns, Fit]:
    """Fit of glass and mirror alone, with free-form terms.

    The spray is lit past the glass by another part of the projector's picture: what its light lacks of the model is not
    what the glass's lacks.
    """
    on_glass = cells.region != REGIONS.index(SPRAYED)
    cells, stage_mm = cells.of(on_glass), stage_mm[on_glass]
    few = np.arange(len(cells)) % max(1, len(cells) // _FEW_CELLS) == 0
    model = unknowns.model(found)
    points = lit_points(model, cells, rays_at(model.intrinsics, cells.pixel), stage_mm)
    fuller = unknowns.with_freeform(freeform_over(points), found)
    begin = np.concatenate([found, np.zeros(len(fuller) - len(unknowns))])
    rough = fit_unknowns(cells.of(few), stage_mm[few], fuller, begin)
    return fuller, fit_unknowns(cells, stage_mm, fuller, rough.values)


def _worth_it(plain: Fit, flexible: Fit) -> bool:
    """Whether free-form terms explain more than the same number of others would."""
    left = flexible.chi2_per_dof
    gained = (plain.chi2_per_dof - left) * len(flexible.residual)
    return gained > _GAIN * left * (len(flexible.values) - len(plain.values))


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
