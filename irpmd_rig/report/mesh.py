"""A surface as few enough points that a page can hold it and a browser can turn it."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_POINTS = 220  # along the longer side
_TOP = 65535
_OUTLIERS = 0.05  # percent at either end that do not count for the range of a colour


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Points on a grid, as `viewer.js` reads them.

    Attributes
    ----------
    points_mm : ndarray of float32, (h, w, 3)
        x, y, z; NaN where there is none.
    labels : ndarray of uint8, (h, w)
        Facets, 0 where there is no point: neighbours of different facets are not joined.
    residual_um : ndarray of float32, (h, w), or None
        Distance of each point from the surface fitted to its facet; NaN where not known.
    """

    points_mm: NDArray[np.float32]
    labels: NDArray[np.uint8]
    residual_um: NDArray[np.float32] | None

    def as_json(self) -> str:
        """Everything in one JSON object: coordinates in 16 bits over their range, base64, little endian."""
        low, high = np.nanmin(self.points_mm, axis=(0, 1)), np.nanmax(self.points_mm, axis=(0, 1))
        content = {
            "rows": self.labels.shape[0],
            "columns": self.labels.shape[1],
            "low_mm": _rounded(low),
            "high_mm": _rounded(high),
            "points": _packed((self.points_mm - low) / np.maximum(high - low, 1e-6)),
            "labels": base64.b64encode(self.labels.tobytes()).decode(),
        }
        if self.residual_um is not None:
            reach = float(np.nanpercentile(np.abs(self.residual_um), 100 - _OUTLIERS)) or 1.0
            content["residual_reach_um"] = round(reach, 4)
            content["residuals"] = _packed((self.residual_um / reach + 1) / 2)
        return json.dumps(content)


def mesh_of(
    points_mm: NDArray[np.floating],
    labels: NDArray[np.integer] | None = None,
    residual_um: NDArray[np.floating] | None = None,
) -> Mesh | None:
    """Every so many points of a surface; None where none is known.

    Parameters
    ----------
    points_mm
        (H, W, 3); NaN where not known.
    labels
        Facets, (H, W): what belongs to none (0) is left out. By default all points belong together.
    residual_um
        (H, W), distance from the surface fitted to the facet.
    """
    stride = max(1, -(-max(points_mm.shape[:2]) // _POINTS))
    points = points_mm[::stride, ::stride].astype(np.float32)
    there = np.isfinite(points).all(axis=-1)
    facets = there.astype(np.uint8) if labels is None else np.where(there, labels[::stride, ::stride], 0)
    if not facets.any():
        return None
    points[facets == 0] = np.nan
    thin = None if residual_um is None else residual_um[::stride, ::stride].astype(np.float32)
    if thin is not None and not np.isfinite(thin[facets > 0]).any():
        thin = None
    return Mesh(points, np.asarray(facets, np.uint8), thin)


def _packed(fraction: NDArray[np.floating]) -> str:
    """Fractions 0 to 1 in 16 bits; what is not known becomes 0, which nobody looks at."""
    whole = np.rint(np.clip(np.nan_to_num(fraction), 0, 1) * _TOP).astype("<u2")
    return base64.b64encode(whole.tobytes()).decode()


def _rounded(values: NDArray[np.floating]) -> list[float]:
    return [round(float(value), 4) for value in values]
