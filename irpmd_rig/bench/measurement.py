"""A measurement in closed form: calibrations, reference and frames of a stepped mirror, of one rig model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.bench.depth import paper_rig
from irpmd_rig.core import BoardPose, CameraCalibration, Plane, RigGeometry
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.processing.archive import ARRAYS, CameraResult, geometry_content
from irpmd_rig.processing.archive_rig import VARIATIONS, model_content
from irpmd_rig.processing.glass import glass_mask
from irpmd_rig.processing.regions import Mask
from irpmd_rig.recipes.models import Method
from irpmd_rig.store import Fringes, Kind, Library, ManifestEntry, RunFolder, RunRecord, RunState, Store, Transition
from irpmd_rig.store.results import CALIBRATION

COUNTS = (64.0, 63.0, 56.0)
STEPS = 4
POSITIONS_MM = (0.0, 40.0)
HEIGHTS_MM = (-11.0, -7.0, 0.0, 5.0, 11.0)
# What of the glass is there to be seen, x and y.
_OUTLINE_MM = ((0.0, -125.0), (250.0, -125.0), (250.0, 125.0), (0.0, 125.0))
_SIGMA_MM = 1e-3
_NOISE_DN = 1.5

Map = NDArray[np.float64]


@dataclass(frozen=True)
class SteppedMirror:
    """Frames of a mirror with five treads and of the glass beside it, in the paper's rig.

    Attributes
    ----------
    size_px
        Side of the square frames.
    bits
        Of a pixel: 8 or 10.
    """

    size_px: int
    bits: int = 8
    outline_mm: Map = field(default_factory=lambda: np.array(_OUTLINE_MM))

    @cached_property
    def rig(self) -> RigModel:
        """What the frames are made of, and what the calibration finds."""
        return paper_rig(self.size_px)

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

    @cached_property
    def _directions(self) -> Map:
        return self.rig.directions()

    def reflected_rad(self, stage1_mm: float, height_mm: Map | float, window: tuple[slice, slice]) -> Map:
        """Absolute phase that level mirrors of these heights show, (h, w) of a window."""
        rig, seen = self.rig, self._directions[window]
        reach = (np.asarray(height_mm) - rig.frame.camera_mm[2]) / seen[..., 2]
        points = rig.frame.camera_mm + reach[..., None] * seen
        lit = rig.meet_glass(rig.still(points, stage1_mm), seen * (1.0, 1.0, -1.0))
        return rig.phase_rad(lit, on_glass=True)

    def glass(self, stage1_mm: float) -> Mask:
        """Where the glass itself is seen, (H, W)."""
        return glass_mask(self.rig, self.outline_mm, stage1_mm)

    def phase_rad(self, stage1_mm: float) -> Map:
        """Absolute phase of the picture, (H, W); NaN where there is no light."""
        phase = np.full((self.size_px, self.size_px), np.nan)
        rows = self.object[0]
        # The treads share the object's rows among themselves.
        tread = np.arange(rows.stop - rows.start) * len(HEIGHTS_MM) // (rows.stop - rows.start)
        phase[self.object] = self.reflected_rad(stage1_mm, np.take(HEIGHTS_MM, tread)[:, None], self.object)
        glass, rig = self.glass(stage1_mm), self.rig
        lit = rig.meet_glass(rig.still(rig.frame.camera_mm, stage1_mm), self._directions[glass])
        phase[glass] = rig.phase_rad(lit, on_glass=True)
        # The projector shows no more than its picture.
        phase[(phase < 0) | (phase > 2 * np.pi * rig.count)] = np.nan
        return phase

    def frames(self, stage1_mm: float) -> Iterator[tuple[int, int, NDArray[Any]]]:
        """Set, step and frame (H, W) of every pattern."""
        rng = np.random.default_rng(0)
        scale = 2.0 ** (self.bits - 8)
        noise = rng.normal(0, _NOISE_DN, (self.size_px, self.size_px)).astype(np.float32)
        phase = self.phase_rad(stage1_mm).astype(np.float32)
        lit = np.isfinite(phase)
        for number, count in enumerate(COUNTS):
            for step in range(STEPS):
                picture = 5.0 + np.roll(noise, 17 * (STEPS * number + step))
                angle = phase[lit] * np.float32(count / COUNTS[0]) + np.float32(2 * np.pi * step / STEPS)
                picture[lit] += 120 + 100 * np.cos(angle)
                frame = np.clip(np.rint(scale * picture), 0, 2**self.bits - 1)
                yield number, step, frame.astype(np.uint8 if self.bits == 8 else np.uint16)


def calibrated(store: Store, mirror: SteppedMirror) -> Library:
    """Put the calibrations and the reference of a stepped mirror into a store, and activate them."""
    size = mirror.size_px
    maps = {f"position_{k + 1}_rad": np.full((size, size), np.nan) for k in range(len(POSITIONS_MM))}
    for stage1_mm, phase in zip(POSITIONS_MM, maps.values(), strict=True):
        phase[mirror.reference] = mirror.reflected_rad(stage1_mm, 0.0, mirror.reference)
    contents: dict[Kind, dict[str, Any]] = {
        "calibrate-camera": _camera(mirror.rig).content(),
        "calibrate-plate": {"counts": list(COUNTS)},
        "calibrate-geometry": geometry_content(_geometry(mirror.rig), 0.0) | {"rig_model": _rig_content(mirror)},
        "reference": {"counts": list(COUNTS), "positions_mm": list(POSITIONS_MM)},
    }
    arrays: dict[Kind, dict[str, NDArray[Any]]] = {
        "calibrate-geometry": {"sprayed": np.zeros((size, size), np.bool_)},
        "reference": maps,
    }
    library, uses = Library(store), dict[Kind, str]()
    for kind, content in contents.items():
        folder = _queued(store, kind, uses, {})
        if kind in arrays:
            folder.results.write_arrays(ARRAYS, arrays[kind])
        if kind == "calibrate-geometry":
            folder.results.write_json(VARIATIONS, {"models": [model_content(model) for model in _varied(mirror.rig)]})
        header = {"kind": kind, "run": folder.id, "size_px": [size, size], "uses": dict(uses)}
        folder.results.write_json(CALIBRATION, header | content)
        _succeed(folder)
        library.activate(folder.id)
        uses[kind] = folder.id
    return library


def _camera(rig: RigModel) -> CameraResult:
    pose = BoardPose(0, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 400.0]), 0.01, 1e-5, 0.05)
    sigmas = (0.05, 0.05), (0.05, 0.05), (1e-4, 1e-4, 1e-5, 1e-5, 0.0), (0.03, 0.03)
    return CameraResult(CameraCalibration(rig.intrinsics, *sigmas, (pose,), ()), 0, 100.0)


def _geometry(rig: RigModel) -> RigGeometry:
    a, b, d_mm = rig.glass
    mirror, glass = (
        Plane(_plane(rig, *heights), np.eye(3) * 1e-18, 0.01, 100_000) for heights in ((0.0, 0.0, 0.0), (a, b, d_mm))
    )
    return RigGeometry(mirror, glass, rig.frame, np.pi / 2, np.pi / 2, 0.0, d_mm, d_mm, 0.006, {"planes": 6.0})


def _plane(rig: RigModel, a: float, b: float, c: float) -> Map:
    """Plane z = a x + b y + c of frame M as q . P = 1 in the camera's frame."""
    normal = np.array([-a, -b, 1.0])
    return np.asarray(rig.frame.axes.T @ normal / (c - normal @ rig.frame.camera_mm))


def _varied(rig: RigModel) -> tuple[RigModel, ...]:
    """The rig with its glass, its stage and its projector displaced by a micrometre or so."""
    a, b, c = rig.glass
    centre = rig.projector.centre_mm + np.array([0.1, 0.0, 0.0])
    return (
        replace(rig, glass=(a, b, c + _SIGMA_MM)),
        replace(rig, stage_axis=rig.stage_axis + np.array([1e-5, 0.0, 0.0])),
        replace(rig, projector=replace(rig.projector, centre_mm=centre)),
    )


def _rig_content(mirror: SteppedMirror) -> dict[str, Any]:
    _, _, d_mm = mirror.rig.glass
    return {
        "model": model_content(mirror.rig),
        "parameters": [{"name": "d", "value": d_mm, "sigma": _SIGMA_MM, "unit": "mm"}],
        "covariance": [[_SIGMA_MM**2]],
        "inflation": 1.0,
        "chi2_per_dof": 1.0,
        "chi2_by_region": {},
        "positions_mm": list(POSITIONS_MM),
        "stage_offsets_mm": [0.0] * len(POSITIONS_MM),
        "along_y": False,
        "flexible": False,
        "undetermined": [],
        "d_mm": d_mm,
        "sigma_d_mm": _SIGMA_MM,
        "glass_outline_mm": mirror.outline_mm.tolist(),
    }


def measured(store: Store, mirror: SteppedMirror, method: Method | None = None) -> RunFolder:
    """Put the frames of a measurement into a store, by the default method or another; it is left as reconstructing."""
    folder = _queued(store, "measure", {}, {} if method is None else {"method": method})
    with folder:
        for station, stage1_mm in enumerate(POSITIONS_MM):
            entry = ManifestEntry(station=station, stage1_mm=stage1_mm, bits=mirror.bits, checks={"ok": True})
            for number, step, frame in mirror.frames(stage1_mm):
                folder.write_frame(frame, entry.model_copy(update={"set": number, "step": step}))
            folder.flush()
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING):
        folder.append_state(Transition(state))
    return folder


def _queued(store: Store, kind: Kind, uses: dict[Kind, str], recipe: dict[str, Any]) -> RunFolder:
    fringes = Fringes(counts=COUNTS, steps=STEPS)
    record = RunRecord(kind=kind, fringes=fringes, uses=dict(uses), recipe=recipe)
    return store.create_run(record, Transition(RunState.QUEUED))


def _succeed(folder: RunFolder) -> None:
    for state in (RunState.PREPARING, RunState.RUNNING, RunState.RECONSTRUCTING, RunState.SUCCEEDED):
        folder.append_state(Transition(state))
