"""The white-plate relation: absolute phase to depth, pixel by pixel (the paper, section 2.2, step 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.arguments import whole_number
from irpmd_rig.core.calibration.intrinsics import BoardPose
from irpmd_rig.core.calibration.plate_kernel import evaluate_polynomials, fit_polynomials
from irpmd_rig.core.calibration.plate_order import OrderResidual, choose_order
from irpmd_rig.core.errors import CalibrationError, FramesError
from irpmd_rig.core.threads import over_rows

# A pixel extrapolates at most this fraction of the phases that it saw: the polynomial is not to be trusted beyond.
_EXTRAPOLATION = 0.05
# A pixel whose positions scatter by more than this share of the travel does not see the plate move: it is dead, or
# its phase folds back.
_LARGEST_SCATTER = 0.005


@dataclass(frozen=True, slots=True)
class PlateRelation:
    """Per-pixel polynomial from absolute phase to the plate's stage2 position.

    Attributes
    ----------
    coefficients_mm : ndarray of float64, (H, W, order + 1)
        Powers of the normalised phase ``(phase - centre_rad) / half_range_rad``, lowest first; NaN where the
        relation is unknown.
    centre_rad, half_range_rad : ndarray of float64, (H, W)
        Middle and half-width of the phases that each pixel saw.
    positions_mm : ndarray of float64, (positions,)
        Stage2 positions that were fitted.
    order : int
        Degree of the polynomials.
    residuals : tuple of OrderResidual
        What each order leaves: why this one was chosen.
    """

    coefficients_mm: NDArray[np.float64]
    centre_rad: NDArray[np.float64]
    half_range_rad: NDArray[np.float64]
    positions_mm: NDArray[np.float64]
    order: int
    residuals: tuple[OrderResidual, ...]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels at which the relation is known, (H, W)."""
        return np.isfinite(self.coefficients_mm[..., 0])

    def position_mm(self, phase_rad: NDArray[np.floating], *, threads: int = 1) -> NDArray[np.float64]:
        """Stage2 position at which the plate would show this phase.

        Parameters
        ----------
        phase_rad : ndarray, (H, W)
            Absolute phase.
        threads : int
            Rows computed at the same time.

        Returns
        -------
        ndarray of float64, (H, W)
            mm; NaN where the phase or the relation is unknown, or the phase lies outside what the pixel saw.

        Raises
        ------
        FramesError
            If the map's shape is not the relation's.
        """
        if phase_rad.shape != self.centre_rad.shape:
            raise FramesError(f"the phase map is {phase_rad.shape}, the plate relation {self.centre_rad.shape}")
        position = np.empty(self.centre_rad.shape)
        phase = np.ascontiguousarray(phase_rad, dtype=np.float64)
        over_rows(
            len(phase),
            threads,
            lambda first, last: evaluate_polynomials(
                phase[first:last],
                self.coefficients_mm[first:last],
                self.centre_rad[first:last],
                self.half_range_rad[first:last],
                1.0 + _EXTRAPOLATION,
                position[first:last],
            ),
        )
        return position


def fit_plate_relation(
    phases_rad: NDArray[np.float32] | Sequence[NDArray[np.float32]],
    positions_mm: Sequence[float] | NDArray[np.float64],
    *,
    order: int | None = None,
    threads: int = 1,
) -> PlateRelation:
    """Fit the per-pixel polynomial from absolute phase to the plate's position.

    Parameters
    ----------
    phases_rad : sequence of ndarray of float32, (positions, H, W)
        Absolute phase at each position; NaN where unknown.
    positions_mm : sequence of float, (positions,)
        Stage2 position of each map.
    order : int, optional
        Degree; by default the smallest whose coherent residual is the best (`choose_order`).
    threads : int
        Rows fitted at the same time.

    Returns
    -------
    PlateRelation
        NaN at pixels that saw fewer than order + 3 positions or left a wide gap between them, whose phases do not
        change, or whose positions scatter about the polynomial by more than 0.5 % of the travel.

    Raises
    ------
    FramesError
        If maps and positions differ in number or the maps in shape.
    CalibrationError
        If there are too few different positions, or no pixel saw enough of them.

    Notes
    -----
    Order 2 biases d by 88 um, order 3 by 2.9, order 4 by 0.0 in the rig of the physics notes, section 6.
    """
    if order is not None:
        whole_number("order", order, least=1)
    try:
        positions = np.asarray(positions_mm, dtype=np.float64)
        maps = [np.asarray(phase) for phase in phases_rad]
    except (TypeError, ValueError) as error:
        raise FramesError(f"the plate relation wants phase maps (positions, H, W) and numbers: {error}") from None
    if isinstance(phases_rad, np.ndarray):
        stack = phases_rad
    elif len({phase.shape for phase in maps}) == 1:
        stack = np.stack(maps)
    else:
        raise FramesError(f"the plate's phase maps differ in shape: {sorted({phase.shape for phase in maps})}")
    if stack.dtype.kind != "f":
        raise FramesError(f"the plate's phase maps must be floating-point numbers, not {stack.dtype}")
    stack = stack.astype(np.float32, copy=False)
    if stack.ndim != 3 or positions.shape != (len(stack),) or not np.all(np.isfinite(positions)):
        raise FramesError(
            f"the plate relation wants one finite position a map, (positions, H, W): "
            f"got maps {stack.shape} and positions {positions.shape}"
        )
    different = len(np.unique(positions))
    needed = (order if order is not None else 1) + 3
    if different < needed:
        raise CalibrationError(
            f"the plate was seen at {different} different positions; at least {needed} are needed: add positions"
        )
    residuals: tuple[OrderResidual, ...] = ()
    if order is None:
        order, residuals = choose_order(stack, positions)
    height, width = stack.shape[1:]
    coefficients = np.empty((height, width, order + 1))
    centre = np.empty((height, width))
    half_range = np.empty((height, width))
    chosen = order
    over_rows(
        height,
        threads,
        lambda first, last: fit_polynomials(
            stack[:, first:last],
            positions,
            chosen + 3,
            _LARGEST_SCATTER * float(np.ptp(positions)),
            coefficients[first:last],
            centre[first:last],
            half_range[first:last],
        ),
    )
    if not np.isfinite(coefficients[..., 0]).any():
        raise CalibrationError(
            f"no pixel saw the plate at {order + 3} or more positions with a phase that changes: "
            "check that the plate is lit by the projector and in the camera's view"
        )
    return PlateRelation(coefficients, centre, half_range, positions, order, residuals)


@dataclass(frozen=True, slots=True)
class PlatePlacement:
    """Where the plate stands in the camera's frame: what turns a stage2 position into an absolute Z.

    Attributes
    ----------
    normal : ndarray, (3,)
        Unit normal of the plate.
    point_mm : ndarray, (3,)
        A point of the plate at `position_mm`.
    position_mm : float
        The stage2 position at which it was measured.
    axis : tuple of float
        Direction of stage2; the camera's optical axis by construction of the rig.
    """

    normal: NDArray[np.float64]
    point_mm: NDArray[np.float64]
    position_mm: float
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def depth_mm(self, position_mm: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Z in the camera frame at which each ray (H, W, 3) meets the plate at `position_mm` (H, W)."""
        travel = (position_mm - self.position_mm) * float(self.normal @ np.array(self.axis))
        return np.asarray((float(self.normal @ self.point_mm) + travel) / (directions @ self.normal))


def place_plate(board: BoardPose, position_mm: float) -> PlatePlacement:
    """Absolute place of the plate from a board that lies on it at a known stage2 position.

    Parameters
    ----------
    board : BoardPose
        Pose of that board, from the camera calibration.
    position_mm : float
        Stage2 position at which it was taken.

    Returns
    -------
    PlatePlacement
        The stage gives relative depth only; 1 mm of error in the absolute one costs 216 um of d (physics notes,
        section 6).
    """
    return PlatePlacement(normal=board.rotation[:, 2], point_mm=board.centre_mm, position_mm=float(position_mm))
