"""Sharpness of projector and camera from the contrast of fringes of several widths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError

Floats = NDArray[np.float64]

CELLS = 8
"""Cells along either side of the picture in which the blur is told."""

_LIT_FRACTION = 0.2
_FEWEST_PX = 50


@dataclass(frozen=True, slots=True, eq=False)
class Sharpness:
    """Contrast that is left of fine fringes.

    Attributes
    ----------
    counts : tuple of float
        Periods across the projector, rising.
    contrast : ndarray, (n,)
        Median over the lit pixels of each set's modulation over that of the widest fringes.
    blur : float
        Standard deviation of a Gaussian blur with this effect, as a share of the projector's width.
    blur_cells : ndarray, (8, 8)
        The same in cells of the picture; NaN where too little is lit.
    """

    counts: tuple[float, ...]
    contrast: Floats
    blur: float
    blur_cells: Floats


def sharpness(modulation_dn: NDArray[np.floating], counts: Sequence[float]) -> Sharpness:
    """Compare the modulations of fringes of several widths.

    Parameters
    ----------
    modulation_dn : ndarray, (sets, H, W)
        Modulation of every set.
    counts : sequence of float
        Their fringe counts, rising; the first so wide that it is hardly blurred.

    Returns
    -------
    Sharpness
        A Gaussian blur of standard deviation s leaves exp(-2 pi^2 s^2 c^2) of c fringes a width.

    Raises
    ------
    CalibrationError
        No fringes are seen.
    """
    wide = modulation_dn[0]
    lit = wide > max(_LIT_FRACTION * float(np.nanpercentile(wide, 99)), 1.0)
    if np.count_nonzero(lit) < _FEWEST_PX:
        raise CalibrationError("no fringes are seen: check light, placement and that the projector is roughly in focus")
    contrast = np.array([float(np.median(one[lit] / wide[lit])) for one in modulation_dn])
    height, width = wide.shape
    rows, columns = np.nonzero(lit)
    cell = rows * CELLS // height * CELLS + columns * CELLS // width
    cells = np.full(CELLS * CELLS, np.nan)
    for number in np.unique(cell):
        inside = cell == number
        if np.count_nonzero(inside) >= _FEWEST_PX:
            place = rows[inside], columns[inside]
            cells[number] = _blur(np.array([np.median(one[place] / wide[place]) for one in modulation_dn]), counts)
    return Sharpness(tuple(counts), contrast, _blur(contrast, counts), cells.reshape(CELLS, CELLS))


def _blur(contrast: Floats, counts: Sequence[float]) -> float:
    squares = np.asarray(counts, dtype=np.float64) ** 2
    # Each logarithm's error grows as its contrast falls: weights by the contrast itself.
    x, y = squares[1:] - squares[0], -np.log(np.maximum(contrast[1:], 1e-3))
    slope = float((contrast[1:] ** 2 * x * y).sum() / (contrast[1:] ** 2 * x * x).sum())
    return float(np.sqrt(max(slope, 0.0) / 2) / np.pi)
