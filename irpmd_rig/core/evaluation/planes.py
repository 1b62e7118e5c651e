"""Planes through facets, without the bias of a fit of z over x and y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import CalibrationError, EvaluationError, FramesError
from irpmd_rig.core.evaluation.facets import Facets
from irpmd_rig.core.frame import ReferenceFrame
from irpmd_rig.core.planes import fit_plane

# A polynomial of this degree over the picture shows whether a surface is curved; what it finds is shape if it is more
# than misalignment bends a plane, and than noise feigns.
_SHAPE_DEGREE = 3
_LEAST_SHAPE_MM = 0.02
_SHAPE_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class FacetPlane:
    """Plane of one facet in frame M: ``z = height + slope . (xy - centre)``.

    Attributes
    ----------
    facet : int
        Its label, 1..count.
    centre_mm : ndarray, (2,)
        x, y of the facet's centre.
    height_mm : float
        Height of the plane at its centre.
    slope : ndarray, (2,)
        dz/dx, dz/dy.
    covariance : ndarray, (3, 3)
        Of (height, slope x, slope y): random noise, inflated for its spatial correlation.
    mean_height_mm : float
        Mean of the pixels' heights.
    rms_mm : float
        Residual of a pixel along its ray.
    pixels : int
        Pixels used.
    flat : bool
        Whether no more shape is left than 20 um rms, or than noise feigns; if not, the plane does not describe the
        facet.
    """

    facet: int
    centre_mm: NDArray[np.float64]
    height_mm: float
    slope: NDArray[np.float64]
    covariance: NDArray[np.float64]
    mean_height_mm: float
    rms_mm: float
    pixels: int
    flat: bool

    def height_at(self, xy_mm: NDArray[np.float64]) -> float:
        """Height of the plane at a point (2,)."""
        return float(self.height_mm + self.slope @ (xy_mm - self.centre_mm))

    def variance_at(self, xy_mm: NDArray[np.float64]) -> float:
        """Variance of `height_at`, mm^2."""
        gradient = np.array([1.0, *(xy_mm - self.centre_mm)])
        return float(gradient @ self.covariance @ gradient)


def fit_facets(
    depth_mm: NDArray[np.floating],
    facets: Facets,
    frame: ReferenceFrame,
    rays: NDArray[np.float64],
) -> tuple[FacetPlane, ...]:
    """Fit a plane to every facet.

    Parameters
    ----------
    depth_mm : ndarray, (H, W)
        Height above the reference plane.
    facets : Facets
        From `find_facets`.
    frame : ReferenceFrame
        The camera's place in frame M.
    rays : ndarray, (H, W, 3)
        Undistorted rays of the pixels in the camera's frame.

    Returns
    -------
    tuple of FacetPlane
        In the facets' order.

    Raises
    ------
    FramesError
        If depth map, labels and rays differ in size.
    EvaluationError
        If a facet has too few pixels to carry a plane.

    Notes
    -----
    The inverse range is fitted over the ray's direction (`irpmd_rig.core.fit_plane`; physics notes, section 4).
    """
    if not depth_mm.shape == facets.labels.shape == rays.shape[:2]:
        raise FramesError(
            f"depth map, facets and rays must be of one size, not {depth_mm.shape}, {facets.labels.shape} "
            f"and {rays.shape}"
        )
    planes = []
    for facet in range(1, facets.count + 1):
        rows, columns = np.nonzero(facets.mask(facet))
        window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        directions = frame.directions(rays[window])
        height = depth_mm[window].astype(np.float64)
        mask = (facets.labels[window] == facet) & np.isfinite(height)
        try:
            planes.append(_fit(facet, height, directions, mask, frame.camera_mm))
        except CalibrationError as error:
            raise EvaluationError(f"facet {facet}: {error}") from None
    return tuple(planes)


def _fit(
    facet: int,
    height_mm: NDArray[np.float64],
    directions: NDArray[np.float64],
    mask: NDArray[np.bool_],
    camera_mm: NDArray[np.float64],
) -> FacetPlane:
    reach = (height_mm - camera_mm[2]) / directions[..., 2]
    plane = fit_plane(directions, reach, mask)
    centre = camera_mm[:2] + (reach[..., None] * directions)[mask][:, :2].mean(axis=0)

    def parameters(q: NDArray[np.float64]) -> NDArray[np.float64]:
        offset = centre - camera_mm[:2]
        return np.array([camera_mm[2] + (1 - q[:2] @ offset) / q[2], -q[0] / q[2], -q[1] / q[2]])

    step = 1e-6 * float(np.linalg.norm(plane.q))
    jacobian = np.stack(
        [(parameters(plane.q + step * e) - parameters(plane.q - step * e)) / (2 * step) for e in np.eye(3)],
        axis=1,
    )
    values = parameters(plane.q)
    residual = (reach - plane.depth_mm(directions)) * directions[..., 2]
    # The residual along the ray's direction vector, turned into height.
    rms = plane.rms_mm * float(np.abs(directions[mask][:, 2]).mean())
    return FacetPlane(
        facet=facet,
        centre_mm=centre,
        height_mm=float(values[0]),
        slope=values[1:],
        covariance=jacobian @ plane.covariance @ jacobian.T,
        mean_height_mm=float(height_mm[mask].mean()),
        rms_mm=rms,
        pixels=plane.pixels,
        flat=_is_flat(residual[mask], mask),
    )


def _is_flat(residual_mm: NDArray[np.float64], mask: NDArray[np.bool_]) -> bool:
    """Whether the pixels' distances from their plane (in the mask's order) have no shape of their own."""
    rows, columns = np.nonzero(mask)
    x, y = (2 * (at - at.min()) / max(int(np.ptp(at)), 1) - 1 for at in (columns, rows))
    degrees = range(_SHAPE_DEGREE + 1)
    design = np.stack([x**i * y**j for i in degrees for j in degrees if i + j <= _SHAPE_DEGREE], axis=1)
    shape = design @ np.linalg.lstsq(design, residual_mm, rcond=None)[0]
    noise2 = float(np.mean((residual_mm - shape) ** 2)) * (design.shape[1] - 3) / len(shape)
    return bool(float(np.mean(shape**2)) <= _LEAST_SHAPE_MM**2 + _SHAPE_SIGMAS**2 * noise2)
