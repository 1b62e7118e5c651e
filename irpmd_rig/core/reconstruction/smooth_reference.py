"""The reference mirror's phase without its noise: a plane mirror leaves a smooth phase."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from irpmd_rig.core.block_sums import block_sums
from irpmd_rig.core.errors import FramesError

# A reflected straight fringe is a ratio of two linear functions of the ray, and the lenses bend it smoothly: this
# degree leaves microradians of it over the picture; means over cells of this size leave tens of them.
_DEGREE = 8
_CELL_PX = 2
_HOLE_PX = 9
_CLIP_ROUNDS = 3
_CLIP_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class SmoothPhase:
    """A phase map replaced by a smooth surface.

    Attributes
    ----------
    phase_rad : ndarray of float64, (H, W)
        NaN outside the region that was measured (small holes are bridged).
    noise_rad : float
        RMS of a pixel against the surface, outliers apart.
    coherent_rad : float
        RMS of the means over blocks of 32 x 32 pixels: what the surface does not describe.
    """

    phase_rad: NDArray[np.float64]
    noise_rad: float
    coherent_rad: float


def smooth_reference(phase_rad: NDArray[np.floating], *, region: NDArray[np.bool_] | None = None) -> SmoothPhase:
    """Fit a smooth surface through the absolute phase of a plane reference mirror.

    Parameters
    ----------
    phase_rad : ndarray, (H, W)
        Absolute phase; NaN where unknown.
    region : ndarray of bool, (H, W), optional
        Where the mirror is seen; everywhere valid by default. Other targets in the picture (the glass itself, a
        sprayed part) must be left out: their phase is another surface.

    Returns
    -------
    SmoothPhase
        A raw reference phase makes the depth's noise 1.5 times larger (physics notes, section 3).

    Raises
    ------
    FramesError
        If too few pixels are valid to carry the surface.
    """
    phase_rad = np.asarray(phase_rad)
    if phase_rad.ndim != 2 or phase_rad.dtype.kind != "f" or (region is not None and region.shape != phase_rad.shape):
        raise FramesError(
            f"the reference phase must be (H, W) floating-point numbers with a region alike, not {phase_rad.shape} "
            f"{phase_rad.dtype}"
        )
    known = np.isfinite(phase_rad) if region is None else np.isfinite(phase_rad) & region
    height, width = phase_rad.shape
    terms = (_DEGREE + 1) * (_DEGREE + 2) // 2
    if known.sum() < 20 * terms:
        raise FramesError(
            f"only {int(known.sum())} pixels of the reference are valid; at least {20 * terms} are needed"
        )
    rows, columns = np.nonzero(known)
    (top, bottom), (left, right) = (rows.min(), rows.max()), (columns.min(), columns.max())
    window = np.s_[top : bottom + 1, left : right + 1]
    # Coordinates over the bounding box of what was measured: the basis is well conditioned there.
    v_axis, u_axis = np.linspace(-1, 1, bottom - top + 1), np.linspace(-1, 1, right - left + 1)
    inside, measured = known[window], phase_rad[window].astype(np.float64)
    for _ in range(_CLIP_ROUNDS):
        coefficients = _fit(np.where(inside, measured, 0.0), inside, v_axis, u_axis)
        basis_v, basis_u = (chebyshev.chebvander(axis, _DEGREE) for axis in (v_axis, u_axis))
        surface = basis_v @ coefficients @ basis_u.T
        residual = np.where(inside, measured - surface, np.nan)
        # A pixel at the mirror's edge mixes two surfaces: a few of them would bend the whole.
        spread = 1.4826 * np.nanmedian(np.abs(residual))
        inside = inside & (np.abs(residual) <= max(_CLIP_SIGMAS * spread, 1e-9))
    residual = np.where(inside, residual, np.nan)
    smooth = np.full((height, width), np.nan)
    # Holes of dust size are bridged; the surface is not carried beyond the mirror's edge.
    bridged = _closed(known[window])
    smooth[window] = np.where(bridged, surface, np.nan)
    return SmoothPhase(smooth, float(np.sqrt(np.nanmean(residual**2))), _coherent(residual))


def _closed(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    side = 2 * _HOLE_PX + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    padded = np.pad(known.astype(np.uint8), side)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc)[side:-side, side:-side]
    return np.asarray(closed, dtype=np.bool_) | known


def _fit(
    phase: NDArray[np.float64],
    known: NDArray[np.bool_],
    v_axis: NDArray[np.float64],
    u_axis: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Chebyshev coefficients (degree + 1, degree + 1) of total degree up to `_DEGREE`, from means of cells."""
    count = block_sums(known.astype(np.float64), _CELL_PX)
    full = count > 0
    v_mean = block_sums(known * v_axis[:, None], _CELL_PX)[full] / count[full]
    u_mean = block_sums(known * u_axis[None, :], _CELL_PX)[full] / count[full]
    values = block_sums(phase, _CELL_PX)[full] / count[full]
    weight = np.sqrt(count[full])
    basis_v, basis_u = chebyshev.chebvander(v_mean, _DEGREE), chebyshev.chebvander(u_mean, _DEGREE)
    pairs = [(i, j) for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
    design = np.stack([basis_v[:, i] * basis_u[:, j] for i, j in pairs], axis=1) * weight[:, None]
    solution, *_ = np.linalg.lstsq(design.T @ design, design.T @ (values * weight), rcond=1e-13)
    coefficients = np.zeros((_DEGREE + 1, _DEGREE + 1))
    for (i, j), value in zip(pairs, solution, strict=True):
        coefficients[i, j] = value
    return coefficients


def _coherent(residual: NDArray[np.float64], side: int = 32) -> float:
    height, width = (size // side * side for size in residual.shape)
    cells = residual[:height, :width].reshape(height // side, side, width // side, side)
    blocks = cells.transpose(0, 2, 1, 3).reshape(-1, side * side)
    full = np.isfinite(blocks).mean(axis=1) > 0.9
    if not full.any():
        return float("nan")
    return float(np.sqrt(np.mean(np.nanmean(blocks[full], axis=1) ** 2)))
