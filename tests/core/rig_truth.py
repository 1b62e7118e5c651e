"""What an exactly known rig shows: the simulated world's truth in the words of the core, and phases traced in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from irpmd_rig.core import Intrinsics, ReferenceFrame
from irpmd_rig.core.rig_model import Projector, RigModel
from sims.frames import attitude, slopes
from sims.optics import Trace, trace
from sims.projection import projector_frame
from sims.setup import Setup
from sims.surfaces import stage1_axis
from sims.world import World

COUNT = 64.0


@dataclass(frozen=True)
class Shown:
    """An object at one stage position: phases (H, W), rad, NaN where the projector's light does not come back."""

    stage1_mm: float
    phase_rad: np.ndarray
    phase_y_rad: np.ndarray
    trace: Trace

    @property
    def reflected(self) -> np.ndarray:
        return (self.trace.kind == 1) & np.isfinite(self.phase_rad)

    @property
    def diffuse(self) -> np.ndarray:
        return (self.trace.kind == 2) & np.isfinite(self.phase_rad)

    @property
    def glass(self) -> np.ndarray:
        return (self.trace.kind == 3) & np.isfinite(self.phase_rad)


def model_of(world: World, count: float = COUNT) -> RigModel:
    """The rig as it truly is; a bow of the glass and a warp of the projector are left out."""
    camera, lens, glass = world.camera, world.projector, world.glass
    centre_mm, axes = projector_frame(lens)
    focal_px = lens.focal_mm / (lens.pixel_um * 1e-3)
    width, height = lens.size_px
    a, b = slopes(glass.tilt_about_x_deg, glass.tilt_about_y_deg)
    x, y, z = glass.centre_mm
    return RigModel(
        intrinsics=Intrinsics(camera.size_px, camera.fc_px, camera.cc_px, camera.kc),
        frame=ReferenceFrame(attitude(camera.axis, camera.roll_deg).T, np.array(camera.position_mm)),
        glass=(a, b, z - a * x - b * y),
        stage_axis=stage1_axis(world.stage1),
        projector=Projector(
            lens.size_px,
            axes,
            centre_mm,
            (focal_px, focal_px),
            ((width - 1) / 2, (height - 1) / 2),
            lens.distortion,
        ),
        count=count,
    )


def phases_of(
    world: World,
    subject: str,
    positions_mm: Sequence[float],
    *,
    sigma_rad: float = 0.0,
    seed: int = 0,
    size_px: int | None = 512,
) -> list[Shown]:
    """What the camera decodes at each stage position, with white noise of the phase."""
    if size_px is not None:
        world = world.with_camera_size(size_px)
    rng = np.random.default_rng(seed)
    shown = []
    for position_mm in positions_mm:
        seen = trace(world, Setup(subject, stage1_mm=position_mm))
        lit = seen.projector_factor_per_mm2 > 0
        phases = [
            np.where(
                lit, 2 * np.pi * COUNT * (seen.projector_px[..., axis] + 0.5) / world.projector.size_px[axis], np.nan
            )
            + sigma_rad * rng.standard_normal(lit.shape)
            for axis in (0, 1)
        ]
        shown.append(Shown(position_mm, *phases, seen))
    return shown
