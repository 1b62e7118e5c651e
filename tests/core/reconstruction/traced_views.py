"""Phases of objects traced in a simulated rig, as the methods of reconstruction take them."""

from dataclasses import dataclass, replace

import numpy as np

from irpmd_rig.core.reconstruction.views import Views
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.shipped import world_file
from sims.world import World, load_world
from tests.core.rig_truth import model_of, phases_of

SIGMA_RAD = 0.0147
TURNED = {
    "glass": {"tilt_about_x_deg": -0.4, "tilt_about_y_deg": 0.3},
    "stage1": {"axis_tilt_about_x_deg": 0.2, "axis_tilt_about_y_deg": -0.5},
    "projector": {"tilt_about_x_deg": -0.7, "roll_deg": 2.0},
    "camera": {"roll_deg": 1.5},
}


@dataclass(frozen=True)
class Seen:
    """Views of an object, and the truth of every pixel; NaN where the object is not seen."""

    views: Views
    depth_mm: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray
    facet: np.ndarray

    def errors_um(self, depth_mm: np.ndarray) -> np.ndarray:
        wrong = (depth_mm - self.depth_mm) * 1e3
        return wrong[np.isfinite(wrong)]


def world_of(name: str) -> World:
    """A shipped world, or one in which every part is turned: "turned", and "mirrored" with a mirrored picture."""
    if name not in ("turned", "mirrored"):
        return load_world(world_file(name))
    world = load_world(world_file("misaligned"))
    changes = {part: getattr(world, part).model_copy(update=turn) for part, turn in TURNED.items()}
    changes["projector"] = changes["projector"].model_copy(update={"mirrored": name == "mirrored"})
    return World.model_validate(world.model_copy(update=changes).model_dump())


def rig_of(world: World, size_px: int) -> RigModel:
    return model_of(world.with_camera_size(size_px))


def seen(world, subject, positions_mm, size_px, *, sigma_rad=0.0, y=False, kind=np.float64, seed=0) -> Seen:
    shown = phases_of(world, subject, positions_mm, sigma_rad=sigma_rad, seed=seed, size_px=size_px)
    phases, phases_y = (
        tuple(np.where(s.reflected, getattr(s, name), np.nan).astype(kind) for s in shown)
        for name in ("phase_rad", "phase_y_rad")
    )
    sigmas = tuple(np.full(phase.shape, sigma_rad or SIGMA_RAD, np.float32) for phase in phases)
    whole = (slice(0, size_px), slice(0, size_px))
    trace = shown[0].trace
    off = ~np.logical_and.reduce([s.reflected for s in shown])
    x, y_, z = (np.where(off, np.nan, trace.normal[..., k]) for k in range(3))
    depth = np.where(off, np.nan, trace.point_mm[..., 2])
    views = Views(tuple(positions_mm), phases, sigmas, whole, phases_y if y else None)
    return Seen(views, depth, -x / z, -y_ / z, np.where(off, -1, trace.facet))


def cut(views: Views, rows: slice, columns: slice) -> Views:
    """A window of views of a whole picture."""
    phases, sigmas = (tuple(m[rows, columns] for m in maps) for maps in (views.phases_rad, views.sigmas_rad))
    return replace(views, phases_rad=phases, sigmas_rad=sigmas, window=(rows, columns))
