"""The camera's lens: pixels from directions (Brown's model) and directions from pixels (its inverse)."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sims.bands import over_rows
from sims.compiled import inner_kernel, kernel
from sims.errors import WorldError
from sims.instruments import Brown, Camera


@inner_kernel
def brown(x: float, y: float, k: Brown) -> tuple[float, float]:
    """Distorted image coordinates of the direction (x, y, 1); k as OpenCV orders it: k1, k2, p1, p2, k3."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    return (
        x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
        y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@inner_kernel
def undistorted(xd: float, yd: float, k: Brown) -> tuple[float, float]:
    """Direction (x, y, 1) whose distorted image coordinates are (xd, yd), by Newton; NaN if it finds none."""
    x, y = xd, yd
    for _ in range(50):
        fx, fy = brown(x, y, k)
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4]))
        xx = radial + x * x * slope + 2.0 * k[2] * y + 6.0 * k[3] * x
        xy = x * y * slope + 2.0 * k[2] * x + 2.0 * k[3] * y
        yy = radial + y * y * slope + 6.0 * k[2] * y + 2.0 * k[3] * x
        determinant = xx * yy - xy * xy
        if determinant <= 0.0:
            break
        ex, ey = xd - fx, yd - fy
        dx = (yy * ex - xy * ey) / determinant
        dy = (xx * ey - xy * ex) / determinant
        x += dx
        y += dy
        if abs(dx) + abs(dy) < 1e-14:
            return x, y
    fx, fy = brown(x, y, k)
    if abs(fx - xd) + abs(fy - yd) < 1e-12:
        return x, y
    return np.nan, np.nan


@kernel
def _rays(first: int, last: int, lens: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    # Five numbers, not a slice: slices are counted references, which two threads would fight for.
    k = (lens[4], lens[5], lens[6], lens[7], lens[8])
    for v in range(first, last):
        for u in range(out.shape[1]):
            x, y = undistorted((u - lens[2]) / lens[0], (v - lens[3]) / lens[1], k)
            out[v, u, 0] = x
            out[v, u, 1] = y


def monotone_reach(distortion: Brown) -> float:
    """Largest squared radius up to which the radial part of Brown's model grows (infinity: everywhere)."""
    k1, k2, _, _, k3 = distortion
    # The derivative 1 + 3 k1 r2 + 5 k2 r2^2 + 7 k3 r2^3 as a polynomial in 1 / r2, whose leading term is never small.
    roots = np.roots([1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3])
    nearest = max((root.real for root in roots if abs(root.imag) < 1e-9), default=0.0)
    return 1.0 / nearest if nearest > 1e-9 else np.inf


def pixel_rays(camera: Camera) -> NDArray[np.float64]:
    """Directions (x/z, y/z) of all pixels in the camera's frame, exact to 1e-12.

    Returns
    -------
    array (H, W, 2), float64, read-only (shared between calls for the same lens).

    Raises
    ------
    WorldError
        The distortion folds the image, so that some pixel has no direction of its own.
    """
    return _cached_rays(camera.size_px, camera.fc_px, camera.cc_px, camera.kc)


@lru_cache(maxsize=2)
def _cached_rays(
    size: tuple[int, int], fc: tuple[float, float], cc: tuple[float, float], kc: Brown
) -> NDArray[np.float64]:
    out = np.empty((size[1], size[0], 2))
    lens = np.array([*fc, *cc, *kc])
    over_rows(lambda first, last: _rays(first, last, lens, out), size[1])
    if not np.all(np.isfinite(out)):
        raise WorldError("camera.kc: this distortion folds the image: some pixels have no direction of their own")
    out.flags.writeable = False
    return out


def project(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (..., 2) of points (..., 3) in the camera's frame, in mm, in front of it."""
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    k1, k2, p1, p2, k3 = camera.kc
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([xd * camera.fc_px[0] + camera.cc_px[0], yd * camera.fc_px[1] + camera.cc_px[1]], axis=-1)
