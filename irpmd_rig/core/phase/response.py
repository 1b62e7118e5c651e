"""The camera's response: from the values it gives to values in proportion to the light."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from irpmd_rig.core.errors import CalibrationError, FramesError


@dataclass(frozen=True, slots=True, eq=False)
class CameraResponse:
    """Lookup from camera values to linear values, straight lines between the points.

    Values outside the points take the nearest end's, as in ``numpy.interp``.

    Parameters
    ----------
    camera_values
        1-D, strictly increasing, at least two; DN of the camera.
    linear_values
        As many, never decreasing, in proportion to the light; any unit.

    Raises
    ------
    CalibrationError
        Points that are no such lookup.
    """

    camera_values: npt.NDArray[np.float64]
    linear_values: npt.NDArray[np.float64]
    _tables: dict[str, npt.NDArray[np.float32]] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("camera_values", "linear_values"):
            try:
                points = np.array(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise CalibrationError(f"the {name} of a response must be a list of numbers: {error}") from error
            points.flags.writeable = False
            object.__setattr__(self, name, points)
        camera, linear = self.camera_values, self.linear_values
        if camera.ndim != 1 or camera.shape != linear.shape or camera.size < 2:
            raise CalibrationError(
                "a camera response needs two 1-D lists of the same length, at least 2 points, "
                f"got shapes {camera.shape} and {linear.shape}"
            )
        if not (np.all(np.isfinite(camera)) and np.all(np.isfinite(linear))):
            raise CalibrationError("a camera response needs finite values")
        if not np.all(np.diff(camera) > 0):
            raise CalibrationError("the camera values of a response must increase strictly")
        if not (np.all(np.diff(linear) >= 0) and linear[-1] > linear[0]):
            raise CalibrationError("the linear values of a response must never decrease, and must increase over all")

    def apply(self, frames: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Linear values of frames of any shape (uint8, uint16 or float32), as float32 of the same shape.

        Raises
        ------
        FramesError
            Frames of another type.
        """
        kind = frames.dtype.newbyteorder("=")
        if kind == np.float32:
            linear = np.interp(frames, self.camera_values, self.linear_values)
            return np.asarray(linear, dtype=np.float32)
        if kind not in (np.uint8, np.uint16):
            raise FramesError(f"frames must be uint8, uint16 or float32, got {frames.dtype}")
        table = self._tables.get(kind.str)
        if table is None:
            every = np.arange(np.iinfo(kind).max + 1)
            table = np.interp(every, self.camera_values, self.linear_values).astype(np.float32)
            self._tables[kind.str] = table
        return np.asarray(table[frames])

    @property
    def step(self) -> float:
        """Mean growth of the linear value over one DN of the camera."""
        rise, run = np.ptp(self.linear_values), np.ptp(self.camera_values)
        return float(rise / run)
