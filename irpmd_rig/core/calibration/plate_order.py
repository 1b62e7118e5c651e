"""Which polynomial order the white plate asks for, judged by what each order leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError

HIGHEST_ORDER = 6
_BLOCKS = 24
_BLOCK_SAMPLES = 24  # pixels along a block's side
# An order is preferred to a higher one if it leaves no more than this factor of the smallest coherent residual.
_AS_GOOD = 1.1


@dataclass(frozen=True, slots=True)
class OrderResidual:
    """What a polynomial order leaves at positions that were left out of the fit.

    Attributes
    ----------
    order : int
        Degree of the polynomial.
    pixel_um : float
        RMS over single pixels: mostly noise, falls no further once the order suffices.
    coherent_um : float
        RMS of the means over blocks of pixels: noise averages out, a wrong order does not.
    """

    order: int
    pixel_um: float
    coherent_um: float


def choose_order(
    phases_rad: NDArray[np.float32], positions_mm: NDArray[np.float64]
) -> tuple[int, tuple[OrderResidual, ...]]:
    """Smallest polynomial order that leaves no coherent residual.

    Parameters
    ----------
    phases_rad : ndarray, (positions, H, W)
        Absolute phase of the plate at each position.
    positions_mm : ndarray, (positions,)
        Stage2 positions.

    Returns
    -------
    order : int
        The choice.
    residuals : tuple of OrderResidual
        For order 1 and up.

    Raises
    ------
    CalibrationError
        If no block of pixels saw enough positions.

    Notes
    -----
    Each position is left out in turn (through the hat matrix). A pixel's own noise of tens of um hides an order's
    bias of a few; the mean over a block does not, and the bias of d is such a mean.
    """
    blocks = _blocks(phases_rad)
    if not blocks:
        raise CalibrationError(
            "no part of the picture saw the plate at five or more positions: check light, focus and exposure"
        )
    fewest = min(len(samples) for samples, _ in blocks)
    residuals = []
    for order in range(1, min(HIGHEST_ORDER, fewest - 3) + 1):
        left_out = [_left_out_residuals(block, positions_mm[seen], order) for block, seen in blocks]
        pixel = np.sqrt(np.mean(np.concatenate([r.ravel() for r in left_out]) ** 2))
        coherent = np.sqrt(np.mean(np.concatenate([r.mean(axis=0) for r in left_out]) ** 2))
        residuals.append(OrderResidual(order, float(1e3 * pixel), float(1e3 * coherent)))
    best = min((residual.coherent_um for residual in residuals), default=float("nan"))
    if not np.isfinite(best):
        raise CalibrationError("the plate's phase does not change with its position: check that it moves and is lit")
    order = next(r.order for r in residuals if r.coherent_um <= _AS_GOOD * best)
    return order, tuple(residuals)


def _blocks(
    phases_rad: NDArray[np.float32],
) -> list[tuple[NDArray[np.float64], NDArray[np.intp]]]:
    """Blocks of pixels that saw the most positions: phases (seen, pixels) and the indices of these positions."""
    _, height, width = phases_rad.shape
    side = max(4, min(height, width) // 32)
    corners = [(v, u) for v in range(0, height - side + 1, side) for u in range(0, width - side + 1, side)]
    stride = max(1, side // _BLOCK_SAMPLES)
    sampled = []
    for v, u in corners:
        block = phases_rad[:, v : v + side : stride, u : u + side : stride].reshape(len(phases_rad), -1)
        seen = np.nonzero(np.isfinite(block).mean(axis=1) > 0.9)[0]
        if seen.size >= 5:
            sampled.append((block, seen))
    most = max((seen.size for _, seen in sampled), default=0)
    # Those that saw nearly all positions, spread over the picture.
    rich = [item for item in sampled if item[1].size >= most - 2]
    chosen = rich[:: max(1, len(rich) // _BLOCKS)][:_BLOCKS]
    blocks = []
    for block, seen in chosen:
        known = np.isfinite(block[seen]).all(axis=0)
        blocks.append((block[seen][:, known].astype(np.float64), seen))
    return [item for item in blocks if item[0].shape[1] > 0]


def _left_out_residuals(phases: NDArray[np.float64], positions: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Residual at each position when it is left out, (pixels, positions), mm."""
    low, high = phases.min(axis=0), phases.max(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        t = ((2 * phases - (low + high)) / (high - low)).T
    if not np.isfinite(t).all():
        return np.full((phases.shape[1], phases.shape[0]), np.nan)
    design = t[:, :, None] ** np.arange(order + 1)
    basis, _ = np.linalg.qr(design)
    residual = positions - np.einsum("pki,pji,j->pk", basis, basis, positions, optimize=True)
    leverage = np.einsum("pki,pki->pk", basis, basis)
    return np.asarray(residual / (1.0 - leverage))
