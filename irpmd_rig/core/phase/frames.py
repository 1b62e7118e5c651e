"""Frames as they come in: checked, and cut into runs of rows that the kernels can read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.arguments import BEYOND, checked_number
from irpmd_rig.core.errors import FramesError, MeasurementError
from irpmd_rig.core.phase._kernels import largest_bits
from irpmd_rig.core.phase.arguments import frame_array
from irpmd_rig.core.phase.response import CameraResponse

Values = npt.NDArray[Any]

_FULL_SCALE_DN = {"uint8": 255.0, "uint16": 1023.0, "float32": float("inf")}
_CHUNK_PX = 65536
_BEYOND = np.float32(BEYOND)


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames (sets, steps, H, W) of uint8, uint16 or float32, any layout, and what they are worth.

    Attributes
    ----------
    saturation_dn
        Value from which a pixel counts as saturated; infinite if none does.
    full_scale_dn
        Largest value that is believed; a larger one means that the assumed number of bits is wrong.
    rounding_dn
        Modulation below this may come from the rounding of float32 alone.
    least_variance_dn2
        Rounding of the values themselves; of the linear values, if there is a response.
    """

    values: Values
    response: CameraResponse | None
    saturation_dn: float
    full_scale_dn: float
    rounding_dn: float
    least_variance_dn2: float

    @property
    def direct(self) -> Values | None:
        """All values as the kernels take them (flat, read-only), or None if they have to be copied."""
        if self.response is not None or not _readable(self.values):
            return None
        flat = self.values.reshape(-1)
        flat.flags.writeable = False
        return flat

    @property
    def rows_a_chunk(self) -> int:
        """Rows that are copied at a time where the frames have to be."""
        return max(1, _CHUNK_PX // int(self.values.shape[3]))

    def raw(self, first_row: int, last_row: int) -> Values:
        """Rows of all frames, (sets, steps, rows, W), contiguous and of the machine's byte order."""
        rows = self.values[:, :, first_row:last_row]
        return np.array(rows, dtype=self.values.dtype.newbyteorder("="), order="C")

    def linear(self, raw: Values) -> Values:
        """Raw values through the camera's response, if there is one."""
        return raw if self.response is None else self.response.apply(raw)


def checked_frames(
    frames: npt.ArrayLike, response: CameraResponse | None = None, saturation_dn: float | None = None
) -> Frames:
    """Frames whose shape, type and values can be decoded; raises FramesError, or MeasurementError for the options."""
    if response is not None and not isinstance(response, CameraResponse):
        raise MeasurementError(f"response must be a CameraResponse or None, got {type(response).__name__}")
    values = frame_array(frames)
    if values.ndim != 4:
        raise FramesError(f"frames must be of shape (sets, steps, H, W), got {values.shape}")
    kind = values.dtype.newbyteorder("=").name
    if kind not in _FULL_SCALE_DN:
        raise FramesError(f"frames must be uint8, uint16 or float32, got {values.dtype}")
    if 0 in values.shape:
        raise FramesError(f"frames must hold at least one set and one pixel, got shape {values.shape}")
    if values.shape[1] < 3:
        raise FramesError(f"a set needs at least 3 phase steps, got {values.shape[1]}: shape {values.shape}")
    assumed = _FULL_SCALE_DN[kind]
    saturation = assumed if saturation_dn is None else checked_number("saturation_dn", saturation_dn, zero=False)
    if kind == "float32":
        largest, quantum = _largest_finite(values), 0.0
    else:
        largest, quantum = min(float(np.iinfo(kind).max), saturation), 1.0
    if response is not None:
        largest, quantum = float(np.abs(response.linear_values).max()), quantum * response.step
    # A weighted sum of a few such values is rounded by about eps times the largest.
    rounding = 16 * float(np.finfo(np.float32).eps) * largest
    tiny = float(np.finfo(np.float32).tiny)
    return Frames(
        values=values,
        response=response,
        saturation_dn=saturation,
        full_scale_dn=assumed if saturation_dn is None else float("inf"),
        rounding_dn=max(rounding, tiny),
        least_variance_dn2=max(quantum**2 / 12, (rounding / 4) ** 2, tiny),
    )


def chunk_count(frames: Frames) -> int:
    """Count the chunks of rows that frames are copied in."""
    return -(-int(frames.values.shape[2]) // frames.rows_a_chunk)


def chunks(first: int, last: int, frames: Frames) -> Iterator[tuple[int, int]]:
    """First and last (excluded) row of the chunks numbered ``first`` to ``last`` (excluded)."""
    rows, height = frames.rows_a_chunk, frames.values.shape[2]
    for chunk in range(first, last):
        yield chunk * rows, min(height, (chunk + 1) * rows)


def _readable(values: Values) -> bool:
    return bool(values.flags.c_contiguous and values.flags.aligned and values.dtype.isnative)


def _largest_finite(values: Values) -> float:
    """Largest size of a float32 value; raises FramesError where one cannot be used."""
    top = np.uint32(0)
    for frame in values.reshape(-1, *values.shape[2:]) if _readable(values) else _each(values):
        bits = np.ascontiguousarray(frame, dtype=np.float32).reshape(-1).view(np.uint32)
        bits.flags.writeable = False
        top = max(top, np.uint32(largest_bits(bits)))
    largest = top.view(np.float32)
    if not largest < _BEYOND:
        with np.errstate(invalid="ignore"):
            bad = ~(np.abs(values) < _BEYOND)
        k, n, v, u = (int(i) for i in np.argwhere(bad)[0])
        raise FramesError(
            f"{np.count_nonzero(bad)} values are not finite (or beyond 1e30), the first in set {k}, "
            f"step {n}, row {v}, column {u}: frames must hold numbers only"
        )
    return float(largest)


def _each(values: Values) -> Iterator[Values]:
    for frames_of_set in values:
        yield from frames_of_set
