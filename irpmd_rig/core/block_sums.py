"""Sums over square blocks of a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def block_sums(values: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Sums over blocks of `side` x `side`, (H // side, W // side); what is left over at the far edges is left out."""
    height, width = (size // side for size in values.shape)
    cells = values[: height * side, : width * side].reshape(height, side, width, side)
    return np.asarray(cells.sum(axis=(1, 3)))
