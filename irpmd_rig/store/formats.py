"""File formats of pictures and point clouds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from irpmd_rig.store.errors import ExportError


def encode_png(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode a picture as PNG.

    Parameters
    ----------
    picture
        uint8 or uint16, (H, W) grey or (H, W, 3) in red, green, blue.

    Raises
    ------
    ExportError
        If it is none.
    """
    colours = picture.ndim == 3 and picture.shape[2] == 3
    if picture.dtype not in (np.uint8, np.uint16) or not (colours or picture.ndim == 2) or picture.size == 0:
        raise ExportError(f"a PNG picture is uint8 or uint16, (H, W) or (H, W, 3), not {picture.dtype} {picture.shape}")
    written, content = cv2.imencode(".png", picture[..., ::-1] if colours else picture)
    if not written:
        raise ExportError(f"a picture of {picture.shape} could not be encoded as PNG")
    return bytes(content)


def grey_picture(values: NDArray[np.generic], low: float | None = None, high: float | None = None) -> NDArray[np.uint8]:
    """Map values linearly to 1..255 between their 0.5 and 99.5 percentile, or the given bounds; unknown ones to 0."""
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(values.shape, dtype=np.uint8)
    seen = values[known].astype(np.float32)
    bottom = float(np.percentile(seen, 0.5)) if low is None else low
    top = float(np.percentile(seen, 99.5)) if high is None else high
    picture = np.zeros(values.shape, dtype=np.uint8)
    picture[known] = 1 + np.clip((seen - bottom) / max(top - bottom, 1e-12), 0, 1) * 254
    return picture


def coloured_picture(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    """Colours (viridis; red, green, blue) for the greys of `grey_picture`: only what is unknown is black."""
    grey = grey_picture(values)
    colours = cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.where(grey[..., None] > 0, colours, 0).astype(np.uint8)


def write_point_cloud(
    stream: BinaryIO, points_mm: NDArray[np.floating], properties: Mapping[str, NDArray[np.generic]]
) -> None:
    """Write points as a binary PLY file.

    Parameters
    ----------
    stream
        Where to.
    points_mm
        (..., 3), in frame M; unknown points (NaN) are left out.
    properties
        More of each point, by name; the shape is that of ``points_mm`` without its last axis.

    Raises
    ------
    ExportError
        If a shape does not fit.
    """
    if points_mm.shape[-1:] != (3,) or any(values.shape != points_mm.shape[:-1] for values in properties.values()):
        raise ExportError(f"points are (..., 3) and a property (...), got points of shape {points_mm.shape}")
    known = np.isfinite(points_mm).all(axis=-1)
    columns = {axis: points_mm[known][:, k] for k, axis in enumerate("xyz")}
    columns |= {name: values[known] for name, values in properties.items()}
    vertices = np.empty(
        int(known.sum()),
        dtype=[(name, np.uint8 if values.dtype == np.bool_ else _ply_type(values)) for name, values in columns.items()],
    )
    for name, values in columns.items():
        vertices[name] = values
    comment = "lengths in mm, frame M: z is the height above the reference plane"
    PlyData([PlyElement.describe(vertices, "vertex")], text=False, comments=[comment], byte_order="<").write(stream)


def _ply_type(values: NDArray[np.generic]) -> type[np.generic]:
    # Doubles carry no more than the measurement has, and some viewers do not read them.
    return np.float32 if np.issubdtype(values.dtype, np.floating) else np.int32
