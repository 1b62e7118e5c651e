"""Frames as files: TIFF, PNG, NumPy's own, and small JPEG for watching."""

from __future__ import annotations

import io
from typing import Any, Literal

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from irpmd_rig.store.formats import encode_png

PictureFormat = Literal["tiff", "png", "npy"]
MEDIA_TYPES: dict[str, str] = {"tiff": "image/tiff", "png": "image/png", "npy": "application/x-npy"}


def encoded(image: NDArray[Any], form: PictureFormat) -> bytes:
    """Encode a frame without loss.

    Parameters
    ----------
    image
        uint8 or uint16, (H, W) or (H, W, 3).
    form
        Which file it is to be.

    Raises
    ------
    irpmd_rig.store.errors.ExportError
        It is no picture.
    """
    if form == "png":
        return encode_png(image)
    stream = io.BytesIO()
    if form == "npy":
        np.save(stream, image, allow_pickle=False)
    else:
        tifffile.imwrite(stream, image, metadata=None)
    return stream.getvalue()


def preview(image: NDArray[Any], bits: int, width_px: int = 1024) -> bytes:
    """Encode a frame as JPEG, at most `width_px` wide; full scale is 2**bits - 1."""
    rows, columns = image.shape[:2]
    if columns > width_px:
        size = (width_px, max(1, round(rows * width_px / columns)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    if bits > 8:
        image = image >> (bits - 8)
    written, content = cv2.imencode(".jpg", image.astype(np.uint8))
    if not written:
        raise ValueError(f"a picture of {image.shape} could not be encoded as JPEG")
    return bytes(content)
