"""How much larger than stated the errors of a fit are whose residuals hang together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.calibration.self_cells import Cells

# Sides of the groups whose sums show it, cells: from the cell itself to a tenth of the picture.
_SIDES = (1, 2, 3, 5, 8, 12)
_FEWEST_GROUPS = 30


def correlation_excess(cells: Cells, residual: NDArray[np.float64], used_up: float) -> float:
    """Factor (at least 1) by which variances of sums over neighbouring residuals exceed the stated noise.

    Parameters
    ----------
    cells : Cells
        Where the residuals are.
    residual : ndarray, (n,)
        In sigmas.
    used_up : float
        Degrees of freedom that the fit took.

    Notes
    -----
    White residuals of the stated size give 1 at every size of group; the largest excess that chance does not explain
    counts. A fit's numbers are sums over large parts of the picture: it is their variance that grows so.
    """
    excess = 1.0
    area = cells.view * 6 + cells.region * 2 + cells.axis
    for side in _SIDES:
        group = np.stack([area, cells.row // side, cells.column // side], axis=1)
        _, member, size = np.unique(group, axis=0, return_inverse=True, return_counts=True)
        sums = np.bincount(np.ravel(member), weights=residual)
        full = size >= 0.5 * side**2
        free = np.count_nonzero(full) - used_up
        if free < _FEWEST_GROUPS:
            break
        here = float(np.sum(sums[full] ** 2 / size[full]) / free)
        if here > 1 + 2.5 * np.sqrt(2 / free):
            excess = max(excess, here)
    return excess
