"""The depth equation (physics notes, section 1) holds exactly for traced phases: the sign convention of the world."""

import numpy as np
import pytest

from sims.optics import Trace, trace
from sims.setup import Setup
from sims.truth import true_d_mm
from sims.world import World


def phase_rad(seen: Trace, columns: int) -> np.ndarray:
    return np.where(seen.kind == 1, 2 * np.pi * 64 * (seen.projector_px[..., 0] + 0.5) / columns, np.nan)


@pytest.mark.parametrize("roll_deg", [0.0, 180.0], ids=["phase grows with x", "phase falls with x"])
@pytest.mark.parametrize("delta_d_mm", [40.0, -60.0], ids=["away", "toward"])
@pytest.mark.parametrize("name", ["mirror_step_y", "mirror_step_x", "fan_x", "mirror_step_tilted", "freeform"])
def test_depth_equation_returns_the_traced_height(ideal: World, name: str, delta_d_mm: float, roll_deg: float) -> None:
    projector = ideal.projector.model_copy(update={"roll_deg": roll_deg})
    world = ideal.model_copy(update={"projector": projector})
    seen = [trace(world, Setup(what, stage1_mm=s)) for what in ("mirror", name) for s in (0.0, delta_d_mm)]
    r1, r2, m1, m2 = (phase_rad(one, projector.size_px[0]) for one in seen)
    reference, measured = r1 - r2, m1 - m2
    d_mm = true_d_mm(world)
    depth = (d_mm * (measured - reference) - delta_d_mm * (r1 - m1)) / (measured + reference)
    known = np.isfinite(depth)
    facets = np.unique(seen[2].facet[known])
    assert facets.size == seen[2].facet.max() + 1
    assert np.abs(depth - seen[2].point_mm[..., 2])[known].max() < 1e-9


def test_stage_moves_the_glass_away_in_the_frame_of_the_mirror(ideal: World) -> None:
    seen = trace(ideal, Setup("mirror", stage1_mm=40.0))
    lit = seen.lit_mm[seen.kind == 1]
    assert np.nanmax(np.abs(lit[:, 2] - 220.0)) < 1e-9


def test_columns_grow_with_x_at_roll_0_and_mirroring_or_a_roll_of_180_turns_them(ideal: World) -> None:
    def slope(**changes: object) -> float:
        projector = ideal.projector.model_copy(update=changes)
        seen = trace(ideal.model_copy(update={"projector": projector}), Setup("nothing"))
        known = np.isfinite(seen.projector_px[..., 0])
        return float(np.polyfit(seen.lit_mm[known][:, 0], seen.projector_px[known][:, 0], 1)[0])

    pixels_per_mm = 50.0 / 0.0108 / 1670.0
    assert slope() == pytest.approx(pixels_per_mm, rel=1e-9)
    assert slope(roll_deg=180.0) == pytest.approx(-pixels_per_mm, rel=1e-9)
    assert slope(mirrored=True) == pytest.approx(-pixels_per_mm, rel=1e-9)


@pytest.mark.parametrize(
    ("part", "change", "error_um"),
    [
        ("glass", {"tilt_about_y_deg": 0.1}, 1.7),
        ("stage1", {"axis_tilt_about_x_deg": 0.5}, 0.3),
        ("stage1", {"axis_tilt_about_y_deg": 0.1}, 22.0),
        ("projector", {"tilt_about_y_deg": 1.0}, 18.0),
        ("projector", {"distortion": (0.005 / 0.11059**2, 0.0, 0.0, 0.0, 0.0)}, 54.0),
    ],
    ids=["glass about y", "stage about x", "stage about y", "projector about y", "projector distortion"],
)
def test_misalignments_cost_what_the_physics_notes_say(
    ideal: World, part: str, change: dict[str, object], error_um: float
) -> None:
    """Largest step error of Table 2's object, treads parallel, steps along y (physics notes, section 4)."""
    world = ideal.with_camera_size(512)
    world = world.model_copy(update={part: getattr(world, part).model_copy(update=change)})
    seen = [trace(world, Setup(what, stage1_mm=s)) for what in ("mirror", "mirror_step_y") for s in (0.0, 40.0)]
    r1, r2, m1, m2 = (phase_rad(one, 1024) for one in seen)
    reference, measured = r1 - r2, m1 - m2
    depth = (180.0 * (measured - reference) - 40.0 * (r1 - m1)) / (measured + reference)
    error = depth - seen[2].point_mm[..., 2]
    means = [np.nanmean(error[seen[2].facet == facet]) for facet in range(5)]
    assert 1e3 * np.abs(np.diff(means)).max() == pytest.approx(error_um, rel=0.25, abs=0.4)
