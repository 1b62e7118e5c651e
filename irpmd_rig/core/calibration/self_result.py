"""From a fit to what a calibration says of itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.rig_calibration import (
    REGIONS,
    SPRAYED,
    Parameter,
    ResidualMap,
    RigCalibration,
)
from irpmd_rig.core.calibration.self_cells import Cells
from irpmd_rig.core.calibration.self_fit import Fit
from irpmd_rig.core.calibration.self_inflation import correlation_excess
from irpmd_rig.core.calibration.self_prior import INTRINSICS
from irpmd_rig.core.calibration.self_unknowns import RIG, STOOD_FOR, Unknowns
from irpmd_rig.core.rig_model import RigModel

Array = NDArray[np.float64]

# A number that the data know no better than this share of what was assumed before is called undetermined.
_OPEN = 0.5
_HELD = "where the projector stands, its turn and its lens: the free-form correction over the glass stands for them"
_SPRAY = (
    "what the sprayed mirror tells of the projector: its phases do not fit those of glass and mirror (chi2 {:.3g} a "
    "degree of freedom) and are left out; check that the spray alone is marked, and is lit past the glass only"
)
_ALWAYS_OPEN = (
    "the scale of lengths: it is the stage's",
    "the figure of the reference mirror: it is taken for flat",
)


def result_of(
    cells: Cells, read_mm: Array, unknowns: Unknowns, fit: Fit, spray_chi2: float | None = None
) -> RigCalibration:
    """Everything that a calibration reports.

    Parameters
    ----------
    cells, read_mm
        What was fitted, and the stage's reading of each view.
    unknowns, fit
        Which numbers, and their estimate.
    spray_chi2
        Of the spray by a fit of all, where it is not among the cells.
    """
    inflation = correlation_excess(cells, fit.residual * np.sqrt(fit.weight), len(cells) - fit.degrees_of_freedom)
    covariance = fit.covariance(inflation)
    sigmas = np.sqrt(np.diag(covariance))
    parts = zip(unknowns.names, fit.values, sigmas, unknowns.units, strict=True)
    squares = fit.weight * fit.residual**2
    shares = {name: squares[cells.region == region] for region, name in enumerate(REGIONS)}
    chi2 = {name: float(part.mean()) for name, part in shares.items() if part.size}
    return RigCalibration(
        model=unknowns.model(fit.values),
        parameters=tuple(Parameter(name, float(value), float(sigma), unit) for name, value, sigma, unit in parts),
        covariance=covariance,
        inflation=inflation,
        chi2_per_dof=fit.chi2_per_dof,
        chi2_by_region=chi2 if spray_chi2 is None else chi2 | {SPRAYED: spray_chi2},
        stage_offsets_mm=tuple(float(offset) for offset in fit.values[unknowns.offsets]),
        flexible=unknowns.freeform is not None,
        along_y=bool((cells.axis == 1).any()),
        undetermined=_undetermined(unknowns, sigmas, spray_chi2),
        residuals=tuple(_map(cells, fit.residual, view, float(stage)) for view, stage in enumerate(read_mm)),
        variations=_variations(unknowns, fit.values, covariance),
    )


def _undetermined(unknowns: Unknowns, sigmas: Array, spray_chi2: float | None) -> tuple[str, ...]:
    before = unknowns.sigmas
    held = () if unknowns.freeform is None else STOOD_FOR
    out = () if held or spray_chi2 is None else (_SPRAY.format(spray_chi2),)
    weak = tuple(
        unknown.if_unknown
        for place, unknown in enumerate(RIG)
        if place >= INTRINSICS and unknown.name not in held and sigmas[place] > _OPEN * before[place]
    )
    return out + weak + ((_HELD,) if held else ()) + _ALWAYS_OPEN


def _map(cells: Cells, residual: Array, view: int, stage_mm: float) -> ResidualMap:
    here = (cells.view == view) & (cells.axis == 0)
    shape = cells.row.max() + 1, cells.column.max() + 1
    picture = np.full(shape, np.nan, dtype=np.float32)
    picture[cells.row[here], cells.column[here]] = residual[here]
    return ResidualMap(stage_mm, cells.side_px, picture)


def _variations(unknowns: Unknowns, values: Array, covariance: Array) -> tuple[RigModel, ...]:
    """Models displaced along the axes of the covariance of what a model holds; the rest is averaged over."""
    fixed = () if unknowns.freeform is None else STOOD_FOR
    varied = [
        place for place, name in enumerate(unknowns.names) if not name.startswith("stage.offset") and name not in fixed
    ]
    size = unknowns.sigmas[varied]
    part = covariance[np.ix_(varied, varied)] / np.outer(size, size)
    variances, directions = np.linalg.eigh(part)
    models = []
    for variance, direction in zip(variances, directions.T, strict=True):
        moved = values.copy()
        moved[varied] += size * direction * np.sqrt(max(float(variance), 0.0))
        models.append(unknowns.model(moved))
    return tuple(models)
