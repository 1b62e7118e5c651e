"""A measurement in closed form: calibrations, reference and frames of a stepped mirror, without a rig."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core import BoardPose, CameraCalibration, Intrinsics, Plane, RigGeometry, reference_frame
from irpmd_rig.processing.archive import ARRAYS, CALIBRATION, CameraResult, geometry_content
from irpmd_rig.store import Fringes, Kind, Library, ManifestEntry, RunFolder, RunRecord, RunState, Store, Transition

COUNTS = (64.0, 63.0, 56.0)
STEPS = 4
POSITIONS_MM = (0.0, 40.0)
D_MM = 180.0
HEIGHTS_MM = (-11.0, -7.0, 0.0, 5.0, 11.0)
# Camera looking down at 37 deg from a height of 330 mm; its picture is some 400 mm wide.
_TILT_RAD = np.deg2rad(37.0)
_CAMERA_MM = 330.0
_PICTURE_MM = 400.0
_RAD_PER_MM = 2 * np.pi / 12.0
_NOISE_DN = 1.5


@dataclass(frozen=True, slots=True)
class SteppedMirror:
    """Frames of a mirror with five treads, and of nothing around it.

    Attributes
    ----------
    size_px
        Side of the square frames.
    bits
        Of a pixel: 8 or 10.
    """

    size_px: int
    bits: int = 8

    @property
    def object(self) -> tuple[slice, slice]:
        """Rows and columns in which the object is seen: as much of the picture as in the paper's rig."""
        return self._part(12, 20), self._part(8, 16)

    @property
    def reference(self) -> tuple[slice, slice]:
        """Rows and columns in which the reference mirror is seen."""
        return self._part(9, 23), self._part(8, 16)

    def _part(self, first: int, last: int) -> slice:
        return slice(self.size_px * first // 32, self.size_px * last // 32)

    def phase_rad(self, stage1_mm: float, height_mm: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Absolute phase of mirrors of these heights (rows, 1): x + (d + s - 2 h) tan(theta) on the glass."""
        x_mm = (np.arange(self.size_px) / self.size_px - 0.5) * _PICTURE_MM
        glass_mm = x_mm + (D_MM + stage1_mm - 2 * np.asarray(height_mm)) * np.tan(_TILT_RAD)
        return np.asarray(32 * 2 * np.pi + _RAD_PER_MM * (glass_mm - D_MM * np.tan(_TILT_RAD)))

    def frames(self, stage1_mm: float) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Set, step and frame (H, W) of every pattern."""
        rng = np.random.default_rng(0)
        scale = 2.0 ** (self.bits - 8)
        noise = rng.normal(0, _NOISE_DN, (self.size_px, self.size_px)).astype(np.float32)
        rows, columns = self.object
        treads = np.repeat(HEIGHTS_MM, -(-self.size_px // len(HEIGHTS_MM)))[: self.size_px]
        # The treads share the object's rows among themselves.
        inside = np.linspace(0, self.size_px - 1, rows.stop - rows.start).astype(int)
        phase = self.phase_rad(stage1_mm, treads[inside][:, None])[:, columns]
        for number, count in enumerate(COUNTS):
            for step in range(STEPS):
                picture = 5.0 + np.roll(noise, 17 * (STEPS * number + step))
                fringes = np.cos(phase * (count / COUNTS[0]) + 2 * np.pi * step / STEPS)
                picture[rows, columns] += 120 + 100 * fringes.astype(np.float32)
                frame = np.clip(np.rint(scale * picture), 0, 2**self.bits - 1)
                yield number, step, frame.astype(np.uint8 if self.bits == 8 else np.uint16)


def calibrated(store: Store, mirror: SteppedMirror) -> Library:
    """Put the calibrations and the reference of a stepped mirror into a store, and activate them."""
    size = mirror.size_px
    focal = size * 1.15
    lens = Intrinsics(
        (size, size), (focal, focal), ((size - 1) / 2, (size - 1) / 2), (-0.137, 0.148, -4e-5, -1.6e-4, 0)
    )
    pose = BoardPose(0, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 400.0]), 0.01, 1e-5, 0.05)
    camera = CameraResult(
        CameraCalibration(lens, (0.05, 0.05), (0.05, 0.05), (1e-4, 1e-4, 1e-5, 1e-5, 0.0), (0.03, 0.03), (pose,), ()),
        0,
        100.0,
    )
    normal = np.array([-np.sin(_TILT_RAD), 0.0, -np.cos(_TILT_RAD)])
    plane = Plane(-normal / _CAMERA_MM, np.eye(3) * 1e-18, 0.01, 100_000)
    frame = reference_frame(plane, camera_xy_mm=(-160.0, 0.0))
    geometry = RigGeometry(plane, plane, frame, np.pi / 2, np.pi / 2, 0.0, D_MM, D_MM, 0.006, {"planes": 6.0})
    maps = {f"position_{k + 1}_rad": np.full((size, size), np.nan) for k in range(len(POSITIONS_MM))}
    for stage1_mm, phase in zip(POSITIONS_MM, maps.values(), strict=True):
        phase[mirror.reference] = mirror.phase_rad(stage1_mm, 0.0)[mirror.reference[1]]
    contents: dict[Kind, dict[str, Any]] = {
        "calibrate-camera": camera.content(),
        "calibrate-plate": {"counts": list(COUNTS)},
        "calibrate-geometry": geometry_content(geometry, 0.0),
        "reference": {"counts": list(COUNTS), "positions_mm": list(POSITIONS_MM)},
    }
    library, uses = Library(store), dict[Kind, str]()
    for kind, content in contents.items():
        folder = _queued(store, kind, uses)
        if kind == "reference":
            folder.results.write_arrays(ARRAYS, maps)
        header = {"kind": kind, "run": folder.id, "size_px": [size, size], "uses": dict(uses)}
        folder.results.write_json(CALIBRATION, header | content)
        _succeed(folder)
        library.activate(folder.id)
        uses[kind] = folder.id
    return library


def measured(store: Store, mirror: SteppedMirror) -> RunFolder:
    """Put the frames of a measurement into a store; it is left as reconstructing."""
    folder = _queued(store, "measure", {})
    with folder:
        for station, stage1_mm in enumerate(POSITIONS_MM):
            entry = ManifestEntry(station=station, stage1_mm=stage1_mm, bits=mirror.bits, checks={"ok": True})
            for number, step, frame in mirror.frames(stage1_mm):
                folder.write_frame(frame, entry.model_copy(update={"set": number, "step": step}))
            folder.flush()
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING):
        folder.append_state(Transition(state))
    return folder


def _queued(store: Store, kind: Kind, uses: dict[Kind, str]) -> RunFolder:
    record = RunRecord(kind=kind, fringes=Fringes(counts=COUNTS, steps=STEPS), uses=dict(uses))
    return store.create_run(record, Transition(RunState.QUEUED))


def _succeed(folder: RunFolder) -> None:
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED):
        folder.append_state(Transition(state))
