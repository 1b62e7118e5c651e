"""Planes seen from one point, fitted without the bias of a least-squares fit in x, y, z."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from irpmd_rig.core.errors import CalibrationError

FEWEST_PIXELS = 50
_CLIP_SIGMAS = 4.0
_CLIP_ROUNDS = 3
# Sides of the blocks whose means show how far neighbouring residuals hang together, px: from the optics' blur to
# beyond the ripple that a projector's rounded grey levels leave (16 projector columns, about 30 camera pixels).
_BLOCKS_PX = (4, 8, 16, 32, 48, 96)
_FEWEST_BLOCKS = 12
# Chance alone makes such an excess once in so many tests; every fit makes some six of them.
_CHANCE = 1e-3


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane q . X = 1 in a frame whose origin is the point from which it is seen.

    Attributes
    ----------
    q : ndarray, (3,)
        Normal divided by the distance from the origin, 1/mm.
    covariance : ndarray, (3, 3)
        Of q, 1/mm^2; inflated where neighbouring residuals hang together.
    rms_mm : float
        Residual of the points along their rays (in the direction of Z).
    pixels : int
        Pixels used.
    """

    q: NDArray[np.float64]
    covariance: NDArray[np.float64]
    rms_mm: float
    pixels: int

    @property
    def normal(self) -> NDArray[np.float64]:
        """Unit normal that points from the plane to the origin, (3,)."""
        return -self.q / np.linalg.norm(self.q)

    @property
    def distance_mm(self) -> float:
        """Distance of the plane from the origin."""
        return float(1.0 / np.linalg.norm(self.q))

    def depth_mm(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiple t of each direction (..., 3) at which it meets the plane."""
        return np.asarray(1.0 / (directions @ self.q))


def fit_plane(
    directions: NDArray[np.float64],
    range_mm: NDArray[np.floating],
    mask: NDArray[np.bool_],
) -> Plane:
    """Plane through the points ``range_mm * directions``, unbiased for noise along the rays.

    Parameters
    ----------
    directions : ndarray, (H, W, 3)
        Ray of every pixel, of any length.
    range_mm : ndarray, (H, W)
        Multiple of the ray at which the surface lies; noisy.
    mask : ndarray of bool, (H, W)
        Pixels to use.

    Returns
    -------
    Plane
        With a covariance scaled by the residuals and inflated for their spatial correlation.

    Raises
    ------
    CalibrationError
        If fewer than 50 finite pixels are left, or they lie on a line.

    Notes
    -----
    On a plane 1/range is linear in the ray's direction, so the noisy quantity stands alone on one side; a fit of
    z over x and y puts the same noise on both and is biased by +8 to +18 um on a 12 mm tread (physics notes,
    section 4). Outliers are clipped symmetrically at four sigma.
    """
    use = mask & np.isfinite(range_mm) & (range_mm != 0)
    rows, columns = np.nonzero(use)
    if rows.size < FEWEST_PIXELS:
        raise CalibrationError(f"a plane needs at least {FEWEST_PIXELS} measured pixels, and {rows.size} are left")
    design = directions[rows, columns].astype(np.float64)
    inverse: NDArray[np.float64] = 1.0 / range_mm[rows, columns].astype(np.float64)
    keep = np.ones(rows.size, dtype=bool)
    for _ in range(_CLIP_ROUNDS):
        residual = inverse - design @ _least_squares(design[keep], inverse[keep])
        spread = 1.4826 * float(np.median(np.abs(residual[keep] - np.median(residual[keep]))))
        # A noise-free plane has no spread: what is left is rounding.
        keep = np.abs(residual) <= max(_CLIP_SIGMAS * spread, 1e-9 * float(np.abs(inverse).max()))
    q = _least_squares(design[keep], inverse[keep])
    residual = inverse[keep] - design[keep] @ q
    variance = float(residual @ residual) / max(residual.size - 3, 1)
    inflation = correlation_inflation(rows[keep], columns[keep], residual)
    covariance = np.asarray(variance * inflation * np.linalg.inv(design[keep].T @ design[keep]), dtype=np.float64)
    depth = 1.0 / inverse[keep]
    return Plane(q, covariance, float(np.sqrt(np.mean((residual * depth**2) ** 2))), int(residual.size))


def _least_squares(design: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    # A QR of a million rows by three, without squaring the condition number as normal equations would.
    orthogonal, triangle = np.linalg.qr(design)
    diagonal = np.abs(np.diag(triangle))
    if diagonal.min() < 1e-9 * diagonal.max():
        raise CalibrationError("the pixels of a plane lie on a line: its orientation cannot be known")
    return np.asarray(np.linalg.solve(triangle, orthogonal.T @ values))


def correlation_inflation(rows: NDArray[np.intp], columns: NDArray[np.intp], residual: NDArray[np.float64]) -> float:
    """Factor by which the variance of block means exceeds that of independent residuals (at least 1).

    The block at which it is largest counts: correlation over a few pixels shows in small blocks, ripple in large
    ones. An excess that chance explains is none.
    """
    variance = float(np.mean(residual**2))
    factor = 1.0
    for side in _BLOCKS_PX:
        block = (rows // side) * 100_003 + columns // side
        _, member, size = np.unique(block, return_inverse=True, return_counts=True)
        full = size >= 0.5 * size.max()
        count = int(full.sum())
        if count < _FEWEST_BLOCKS or variance == 0:
            break
        means = np.bincount(member, weights=residual) / size
        # The plane has taken three degrees of freedom from the block means.
        excess = float((means[full] ** 2 * size[full]).sum() / (count - 3) / variance)
        if excess > special.chdtri(count - 3, _CHANCE) / (count - 3):
            factor = max(factor, excess)
    return factor
