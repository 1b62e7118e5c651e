"""Objects of the simulated world as the reconstruction is given them: phases of their pixels, and a noisy depth."""

from dataclasses import dataclass, replace

import numpy as np

from irpmd_rig.core.reconstruction.views import DepthMap, Views
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.shipped import world_file
from sims.optics import Trace
from sims.world import World, load_world
from tests.core.rig_truth import model_of, phases_of

# Eight bits, N = 4 (physics notes, section 3), and what triangulation makes of it.
SIGMA_RAD, DEPTH_SIGMA_MM = 0.0147, 0.082
# Stated for phases without noise.
EXACT_RAD = 1e-4


@dataclass(frozen=True)
class Seen:
    """Views without noise, and the truth in the same window."""

    world: World
    model: RigModel
    views: Views
    depth_mm: np.ndarray
    facet: np.ndarray
    truth: Trace

    def views_with(self, sigma_rad: float, seed: int) -> Views:
        rng = np.random.default_rng(seed)
        sigmas = tuple(np.full(self.views.shape, sigma_rad or EXACT_RAD, np.float32) for _ in self.views.positions_mm)

        def noisy(phases):
            return tuple(phase + sigma_rad * rng.standard_normal(phase.shape) for phase in phases)

        along_y = None if self.views.phases_y_rad is None else noisy(self.views.phases_y_rad)
        return replace(self.views, phases_rad=noisy(self.views.phases_rad), sigmas_rad=sigmas, phases_y_rad=along_y)

    def depth_with(self, sigma_mm: float, seed: int) -> DepthMap:
        noise = np.random.default_rng(1000 + seed).standard_normal(self.depth_mm.shape)
        # A depth without noise is stated as an unsure one, so that it does not help the phases.
        sigma = np.full(self.depth_mm.shape, sigma_mm or DEPTH_SIGMA_MM, np.float32)
        return DepthMap((self.depth_mm + sigma_mm * noise).astype(np.float32), sigma)


def misaligned(**parts: dict[str, float]) -> World:
    """The misaligned world with other numbers, e.g. ``glass={"bow_um": 20.0}``."""
    world = load_world(world_file("misaligned"))
    changed = {name: getattr(world, name).model_copy(update=values) for name, values in parts.items()}
    return World.model_validate(world.model_copy(update=changed).model_dump())


def seen(
    name: str,
    positions_mm: tuple[float, ...] = (0.0, 40.0),
    *,
    size_px: int = 384,
    world: World | None = None,
    with_y: bool = False,
) -> Seen:
    world = world or misaligned()
    shown = phases_of(world, name, positions_mm, size_px=size_px)
    valid = np.logical_and.reduce([one.reflected & (one.trace.facet >= 0) for one in shown])
    rows, columns = np.nonzero(valid)
    window = np.s_[rows.min() - 2 : rows.max() + 3, columns.min() - 2 : columns.max() + 3]

    def cut(phase):
        return np.where(valid, phase, np.nan)[window]

    views = Views(
        positions_mm,
        tuple(cut(one.phase_rad) for one in shown),
        tuple(np.full(valid[window].shape, EXACT_RAD, np.float32) for _ in shown),
        window,
        tuple(cut(one.phase_y_rad) for one in shown) if with_y else None,
    )
    truth = shown[0].trace
    facet = np.where(valid, truth.facet, -1)[window]
    world = world.with_camera_size(size_px)
    return Seen(world, model_of(world), views, cut(truth.point_mm[..., 2]), facet, truth)
