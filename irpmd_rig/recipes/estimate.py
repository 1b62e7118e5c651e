"""What a plan takes: disk, time and motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from irpmd_rig.recipes.equipment import Axis, Equipment
from irpmd_rig.recipes.models import Recipe
from irpmd_rig.recipes.stations import Plan, Station

# A camera that is not known is taken to be the paper's.
_SIZE_PX = (2048, 2048)
_SPEED_MM_PER_S = 10.0
_AUTO_EXPOSURE_S = 0.02
_TRIALS = 3
_SETTLE_FRAMES = 5
# Showing a picture and asking for a frame of it: 70 ms on a rig of this kind (instruments' notes, section 4).
_SOFTWARE_S = 0.07
# A frame's file header and its line in the manifest.
_OVERHEAD_BYTES = 2048


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a run takes; results and the operator's time are not counted.

    Attributes
    ----------
    frames : int
        Frames that are kept.
    bytes : int
        Of these frames on disk.
    seconds : float
        Motion, settling, waiting, exposures and frames.
    motion_mm : mapping
        Path of each stage in millimetres, from its first station on.
    prompts : int
        How often the operator is asked.
    """

    frames: int
    bytes: int
    seconds: float
    motion_mm: Mapping[str, float]
    prompts: int


def estimate(
    recipe: Recipe, plan: Plan, equipment: Equipment, positions_mm: Mapping[str, float] | None = None
) -> Estimate:
    """Estimate what a plan takes.

    Parameters
    ----------
    recipe, plan
        A recipe and its plan.
    equipment
        The rig; what is not known of it is taken as on the paper's.
    positions_mm
        Where the stages stand now, in millimetres by name; a stage that is left out starts at its first target.
    """
    places = dict(positions_mm or {})
    motion = {stage: 0.0 for station in plan.stations for stage in targets(station)}
    software = (recipe.trigger or equipment.trigger) == "software"
    seconds = 0.0
    for station in plan.stations:
        for stage, target_mm in targets(station).items():
            path_mm = abs(target_mm - places.get(stage, target_mm))
            axis = equipment.stages.get(stage) or Axis(0.0, 0.0)
            if path_mm:
                seconds += path_mm / (axis.speed_mm_per_s or _SPEED_MM_PER_S) + axis.settle_s
            motion[stage] += path_mm
            places[stage] = target_mm
        seconds += _still_s(station, software, equipment.frame_period_s)
    width, height = equipment.camera_size_px or _SIZE_PX
    pixel_bytes = 1 if recipe.pixel_format == "Mono8" else 2
    return Estimate(
        frames=plan.frames,
        bytes=plan.frames * (width * height * pixel_bytes + _OVERHEAD_BYTES),
        seconds=seconds,
        motion_mm=motion,
        prompts=sum(station.prompt is not None for station in plan.stations),
    )


def targets(station: Station) -> dict[str, float]:
    """Targets of a station in millimetres, by stage."""
    places = (("stage1", station.stage1_mm), ("stage2", station.stage2_mm))
    return {stage: target_mm for stage, target_mm in places if target_mm is not None}


def _still_s(station: Station, software: bool, frame_period_s: float) -> float:
    """Time of a station beside its motion."""
    auto = station.exposure_us == "auto"
    exposure_s = _AUTO_EXPOSURE_S if station.exposure_us == "auto" else station.exposure_us * 1e-6
    frame_s = max(frame_period_s, exposure_s)
    alone_s = frame_s + _SOFTWARE_S
    tried = _TRIALS * (auto and station.frames > 0) + _SETTLE_FRAMES * (station.settle == "measured")
    in_burst = 0 if software else sum(shot.frames for shot in station.shots if shot.role == "fringes")
    return station.wait_s + in_burst * frame_s + (station.frames - in_burst + tried) * alone_s
