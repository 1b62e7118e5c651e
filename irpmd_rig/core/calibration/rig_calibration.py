"""What a self-calibration of the rig takes and returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.rig_model import RigModel

MIRROR, SPRAYED, GLASS = "mirror", "sprayed", "glass"
REGIONS = (MIRROR, SPRAYED, GLASS)

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RigView:
    """What the camera sees of reference mirror and glass at one stage position.

    Attributes
    ----------
    stage1_mm : float
        The stage's position as it reads; grows AWAY from the glass.
    phase_rad : ndarray of float, (H, W)
        Absolute phase along x, rad; NaN where unknown. The pattern's own error is removed by the caller.
    sigma_rad : float or ndarray, (H, W)
        One sigma of a pixel's phase.
    mirror, sprayed, glass : ndarray of bool, (H, W)
        The glass reflected in the mirror, the sprayed part of the mirror, and the glass seen directly: disjoint,
        without the rims at which two of them share a pixel.
    phase_y_rad : ndarray of float, (H, W), optional
        Absolute phase along y.
    """

    stage1_mm: float
    phase_rad: NDArray[np.floating]
    sigma_rad: float | NDArray[np.floating]
    mirror: Mask
    sprayed: Mask
    glass: Mask
    phase_y_rad: NDArray[np.floating] | None = None

    def region(self, name: str) -> Mask:
        """The mask of one of `REGIONS`."""
        return {MIRROR: self.mirror, SPRAYED: self.sprayed, GLASS: self.glass}[name]


@dataclass(frozen=True, slots=True)
class NominalProjector:
    """What is known of the projector before; lens, place and shape of its pixels are found from the phases.

    Attributes
    ----------
    size_px : tuple of int
        Columns and rows of the pictures that it shows.
    count : float
        Fringe count to which the absolute phases belong: the finest set's.
    """

    size_px: tuple[int, int]
    count: float


@dataclass(frozen=True, slots=True)
class Parameter:
    """One estimated number of the rig.

    Attributes
    ----------
    name, unit : str
        What it is.
    value, sigma : float
        Estimate and one sigma, inflated for correlated residuals. Numbers of the projector that free-form terms stand
        for are held, which their sigma does not say (`RigCalibration.undetermined` does).
    """

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class ResidualMap:
    """Measured minus modelled phase of one view, on a coarse grid.

    Attributes
    ----------
    stage1_mm : float
        Which view.
    block_px : int
        Camera pixels along a side of a cell; cell (i, j) starts at row i * block_px, column j * block_px.
    sigmas : ndarray of float32, (H / block_px, W / block_px)
        Residual of each cell over its own one sigma; NaN where nothing was used.
    """

    stage1_mm: float
    block_px: int
    sigmas: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class RigCalibration:
    """The rig as its own fringes show it, and how well it is known.

    Attributes
    ----------
    model : RigModel
        The estimate.
    parameters : tuple of Parameter
        Every estimated number; coefficients of the free-form terms last.
    covariance : ndarray, (P, P)
        Of the parameters, in their order and units; inflated for correlated residuals.
    inflation : float
        Factor by which the variances were inflated.
    chi2_per_dof : float
        Of the cells' residuals against their stated noise: near 1 where the model describes the rig.
    chi2_by_region : dict
        The same, mean over the cells of ``mirror``, ``sprayed`` and ``glass``. Of a spray that was left out, and of a
        calibration with free-form terms, the spray's is that of the rig's numbers alone.
    stage_offsets_mm : tuple of float
        What to add to the stage's reading of each view.
    flexible : bool
        Whether the free-form terms (bow of the glass, correction of the phase) were asked for by the residuals.
    along_y : bool
        Whether the model holds for phases along y: they were given, and are described without free-form terms.
    undetermined : tuple of str
        What these data cannot determine, in plain words; weak assumptions hold it.
    residuals : tuple of ResidualMap
        One a view.
    variations : tuple of RigModel
        Models displaced by one sigma along independent directions: any result f has the calibration covariance
        sum over k of the outer product of f(variation k) - f(model) with itself.
    """

    model: RigModel
    parameters: tuple[Parameter, ...]
    covariance: NDArray[np.float64]
    inflation: float
    chi2_per_dof: float
    chi2_by_region: dict[str, float]
    stage_offsets_mm: tuple[float, ...]
    flexible: bool
    along_y: bool
    undetermined: tuple[str, ...]
    residuals: tuple[ResidualMap, ...]
    variations: tuple[RigModel, ...]
