"""What the rig's numbers cannot express: a bow of the glass and a smooth correction of the phase."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from irpmd_rig.core.rig_model import Correction, RigModel

Array = NDArray[np.float64]
Pairs = tuple[tuple[int, int], ...]

# A glass bends in few waves; a lens's departure from Brown's model, or a screen's waves, may have more.
_BOW_DEGREE = 4
_PHASE_DEGREE = 10
# Size of the lowest coefficients before the data are looked at; each degree more is smaller by the factor, so that
# what no ray has met stays smooth.
_BOW_MM = 0.05
_PHASE_RAD = 0.5
_DECAY = 0.6


def _pairs(least: int, degree: int) -> Pairs:
    return tuple((i, j) for i in range(degree + 1) for j in range(degree + 1 - i) if i + j >= least)


# A plane is the glass's own; constant and slopes of the phase are the projector's.
_BOW = _pairs(2, _BOW_DEGREE)
_PHASE = _pairs(2, _PHASE_DEGREE)
_MARGIN = 0.03  # of the width: rays move a little while the rig's numbers settle


@dataclass(frozen=True, slots=True)
class Freeform:
    """Chebyshev polynomials over the glass.

    Attributes
    ----------
    x_mm, y_mm : tuple of float
        Domain.
    """

    x_mm: tuple[float, float]
    y_mm: tuple[float, float]

    @property
    def sigmas(self) -> Array:
        """Size of each coefficient before the data are looked at: mm of the bow, then rad."""
        return np.concatenate(
            [
                [_BOW_MM * _DECAY ** (i + j - 2) for i, j in _BOW],
                [_PHASE_RAD * _DECAY ** (i + j - 2) for i, j in _PHASE],
            ]
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of each coefficient."""
        groups = (("glass.bow", _BOW), ("phase.correction", _PHASE))
        return tuple(f"{name}_{i}_{j}" for name, pairs in groups for i, j in pairs)

    @property
    def units(self) -> tuple[str, ...]:
        """Of each coefficient."""
        return ("mm",) * len(_BOW) + ("rad",) * len(_PHASE)

    def added_to(self, rig: RigModel, coefficients: Array) -> RigModel:
        """The rig with its bow and correction."""
        bow = Correction(self.x_mm, self.y_mm, _matrix(_BOW, coefficients[: len(_BOW)]))
        phase = Correction(self.x_mm, self.y_mm, _matrix(_PHASE, coefficients[len(_BOW) :]))
        return replace(rig, bow_mm=bow, correction_rad=phase)

    def design(self, points_mm: Array, along_x: NDArray[np.bool_], by_height: Array) -> Array:
        """Derivatives, (n, coefficients), of phases.

        Parameters
        ----------
        points_mm : ndarray, (n, 3)
            Points of the glass.
        along_x : ndarray of bool, (n,)
            Which of the phases are along x.
        by_height : ndarray, (n,)
            Derivative of each phase with the glass's height.
        """
        bow = self._basis(points_mm, _BOW) * by_height[:, None]
        return np.concatenate([bow, self._basis(points_mm, _PHASE) * along_x[:, None]], axis=1)

    def _basis(self, points_mm: Array, pairs: Pairs) -> Array:
        degree = max(i for i, _ in pairs)
        along_x, along_y = (
            chebyshev.chebvander(np.clip((2 * points_mm[:, axis] - low - high) / (high - low), -1, 1), degree)
            for axis, (low, high) in enumerate((self.x_mm, self.y_mm))
        )
        return np.stack([along_x[:, i] * along_y[:, j] for i, j in pairs], axis=1)


def freeform_over(points_mm: Array) -> Freeform:
    """Free-form terms over the points (n, 3) of the glass that the rays meet."""
    low, high = points_mm[:, :2].min(axis=0), points_mm[:, :2].max(axis=0)
    margin = _MARGIN * (high - low)
    (left, right), (bottom, top) = np.stack([low - margin, high + margin], axis=1).tolist()
    return Freeform((left, right), (bottom, top))


def _matrix(pairs: Pairs, coefficients: Array) -> Array:
    size = 1 + max(i for i, _ in pairs)
    matrix = np.zeros((size, size))
    for (i, j), value in zip(pairs, coefficients, strict=True):
        matrix[i, j] = value
    return matrix
