"""In any world, every traced ray obeys the law of reflection and hits what it says, lit by whom it says."""

import cv2
import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sims.optics import trace
from sims.setup import Setup
from sims.world import World

TILT = st.floats(-2.0, 2.0)


@st.composite
def changes(draw: st.DrawFn) -> dict[str, dict[str, object]]:
    """Misalignments of any sign, far beyond those of a real rig."""
    return {
        "glass": {
            "tilt_about_x_deg": draw(TILT),
            "tilt_about_y_deg": draw(TILT),
            "bow_um": draw(st.sampled_from([0.0, 20.0, -500.0])),
        },
        "stage1": {"axis_tilt_about_x_deg": draw(TILT), "axis_tilt_about_y_deg": draw(TILT)},
        "projector": {
            "tilt_about_x_deg": draw(TILT),
            "tilt_about_y_deg": draw(TILT),
            "tilt_pivot_mm": draw(st.sampled_from([0.0, 1670.0])),
            "roll_deg": draw(st.sampled_from([0.0, 180.0, 7.0])),
            "mirrored": draw(st.booleans()),
            "distortion": draw(
                st.tuples(*[st.floats(-b, b) for b in (0.5, 2.0, 0.01, 0.01, 2.0)]),
            ),
        },
        "camera": {"roll_deg": draw(st.sampled_from([0.0, -3.0]))},
    }


def turned(about_x_deg: float, about_y_deg: float) -> Rotation:
    """Extrinsic: about x, then about the fixed y axis."""
    return Rotation.from_euler("xy", [about_x_deg, about_y_deg], degrees=True)


def projector_pixels(world: World, points: np.ndarray) -> np.ndarray:
    """Pixels of points of W, by OpenCV's own projection."""
    p = world.projector
    roll = Rotation.from_rotvec([0, 0, np.radians(p.roll_deg)])
    # At roll 0 and looking down: columns along +x, rows along -y, forward -z.
    axes = roll.as_matrix().T @ np.diag([1.0, -1.0, -1.0])
    tilt = turned(p.tilt_about_x_deg, p.tilt_about_y_deg)
    pivot = np.array(p.position_mm) - [0.0, 0.0, p.tilt_pivot_mm]
    position = pivot + tilt.apply(np.array(p.position_mm) - pivot)
    local = tilt.inv().apply(points - position) @ axes.T
    if p.mirrored:
        local[:, 0] *= -1
    focal = p.focal_mm / p.pixel_um * 1e3
    matrix = np.array([[focal, 0, (p.size_px[0] - 1) / 2], [0, focal, (p.size_px[1] - 1) / 2], [0, 0, 1]])
    out, _ = cv2.projectPoints(local, np.zeros(3), np.zeros(3), matrix, np.array(p.distortion))
    return out.reshape(-1, 2)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    change=changes(),
    subject=st.sampled_from(["mirror", "mirror_step_tilted", "mirror_step_x", "fan_y", "freeform"]),
    stage1_mm=st.floats(-60.0, 60.0),
)
def test_every_traced_ray_obeys_the_law_of_reflection(
    ideal: World, change: dict[str, dict[str, object]], subject: str, stage1_mm: float
) -> None:
    parts = {part: getattr(ideal, part).model_copy(update=update) for part, update in change.items()}
    world = ideal.model_copy(update=parts).with_camera_size(96)
    seen = trace(world, Setup(subject, stage1_mm=stage1_mm))

    specular = (seen.kind == 1) & np.isfinite(seen.lit_mm[..., 0])
    normal = seen.normal[specular]
    arriving = seen.point_mm[specular] - np.array(world.camera.position_mm)
    arriving /= np.linalg.norm(arriving, axis=1)[:, None]
    leaving = seen.lit_mm[specular] - seen.point_mm[specular]
    leaving /= np.linalg.norm(leaving, axis=1)[:, None]
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max(initial=0) < 1e-14
    assert np.all((arriving * normal).sum(axis=1) < 0)
    # Angle in = angle out, and all three directions in one plane.
    assert np.abs(((arriving + leaving) * normal).sum(axis=1)).max(initial=0) < 1e-13
    assert np.abs(np.cross(leaving - arriving, normal)).max(initial=0) < 1e-13

    lit = np.isfinite(seen.lit_mm[..., 0]) & (seen.kind != 2)
    axis = turned(world.stage1.axis_tilt_about_x_deg, world.stage1.axis_tilt_about_y_deg).apply([0.0, 0.0, -1.0])
    in_world = seen.lit_mm[lit] + stage1_mm * axis
    glass = world.glass
    local = turned(glass.tilt_about_x_deg, glass.tilt_about_y_deg).inv().apply(in_world - np.array(glass.centre_mm))
    share = local[:, :2] / (np.array(glass.size_mm) / 2)
    assert np.abs(local[:, 2] - glass.bow_um * 1e-3 * (share**2).sum(axis=1)).max(initial=0) < 1e-11
    assert np.abs(share).max(initial=0) <= 1 + 1e-12

    arrived = np.isfinite(seen.projector_px[..., 0])
    expected = projector_pixels(world, seen.lit_mm[arrived] + stage1_mm * axis)
    assert np.abs(seen.projector_px[arrived] - expected).max(initial=0) < 1e-8
    assert np.array_equal(arrived, seen.projector_factor_per_mm2 > 0)
