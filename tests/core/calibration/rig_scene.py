"""A rig that is off in every way, what its camera shows for a self-calibration, and facets measured through a model."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from irpmd_rig.core import CameraCalibration, Checkerboard, Plane, RigGeometry, reference_frame
from irpmd_rig.core.calibration.intrinsics import BoardPose
from irpmd_rig.core.calibration.rig_calibration import NominalProjector, RigView
from irpmd_rig.core.camera import rays_at
from irpmd_rig.core.rig_model import RigModel
from irpmd_rig.shipped import world_file
from sims.world import World, load_world
from tests.core.rig_truth import Shown, model_of, phases_of

SIZE_PX = 384
# Noise of a pixel of a small picture that leaves as much in its means as 14.7 mrad in those of 2048 x 2048.
SIGMA_RAD = 14.7e-3 * SIZE_PX / 2048
POSITIONS_MM = (0.0, -40.0, -80.0, 40.0)
CORNER_NOISE_PX = 0.031 * SIZE_PX / 2048
PROJECTOR = NominalProjector((1024, 768), 64.0)


@dataclass(frozen=True)
class Scene:
    """One rig, and what a self-calibration is given of it."""

    world: World
    truth: RigModel
    camera: CameraCalibration
    geometry: RigGeometry
    views: tuple[RigView, ...]
    shown: tuple[Shown, ...]


def turned_world(seed: int, *, bow_um: float = 0.0, warp_px: float = 0.0, mirrored: bool = False) -> World:
    """Glass and stage off by 0.1 deg, the projector by 1 deg and 0.3 % either way, about axes that the seed draws."""
    rng = np.random.default_rng(seed)
    world = load_world(world_file("misaligned"))

    def turn(angle_deg: float) -> tuple[float, float]:
        about = rng.uniform(0, 2 * np.pi)
        return float(angle_deg * np.cos(about)), float(angle_deg * np.sin(about))

    glass, stage, projector = turn(0.1), turn(0.1), turn(1.0)
    lens = tuple(float(rng.choice([-1.0, 1.0])) * k for k in world.projector.distortion)
    parts = {
        "glass": {"tilt_about_x_deg": glass[0], "tilt_about_y_deg": glass[1], "bow_um": bow_um},
        "stage1": {"axis_tilt_about_x_deg": stage[0], "axis_tilt_about_y_deg": stage[1]},
        "projector": {
            "tilt_about_x_deg": projector[0],
            "tilt_about_y_deg": projector[1],
            "distortion": lens,
            "warp_amplitude_px": warp_px,
            "mirrored": mirrored,
        },
    }
    changed = {name: getattr(world, name).model_copy(update=part) for name, part in parts.items()}
    return World.model_validate(world.model_copy(update=changed).model_dump()).with_camera_size(SIZE_PX)


def scene_of(
    world: World,
    seed: int,
    *,
    sigma_rad: float = SIGMA_RAD,
    stage_noise_mm: float = 1e-3,
    stated_rad: float = SIGMA_RAD,
) -> Scene:
    """Views with noise of phases and stage, a checkerboard's intrinsics, and a rough geometry."""
    rng = np.random.default_rng(1000 + seed)
    truth = model_of(world)
    true_mm = [position + stage_noise_mm * rng.standard_normal() for position in POSITIONS_MM]
    shown = phases_of(world, "mirror", true_mm, sigma_rad=sigma_rad, seed=seed, size_px=None)
    views = tuple(view_of(one, read, stated_rad) for one, read in zip(shown, POSITIONS_MM, strict=True))
    return Scene(world, truth, checkerboard(truth, rng), rough_geometry(truth), views, tuple(shown))


def view_of(shown: Shown, read_mm: float, sigma_rad: float) -> RigView:
    masks = (eroded(mask) for mask in (shown.reflected, shown.diffuse, shown.glass))
    return RigView(read_mm, shown.phase_rad, sigma_rad, *masks)


def eroded(mask: np.ndarray) -> np.ndarray:
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3)), borderValue=0).astype(bool)


def checkerboard(truth: RigModel, rng: np.random.Generator, boards: int = 30) -> CameraCalibration:
    """The camera calibrated from boards whose corners are noisy."""
    lens, board = truth.intrinsics, Checkerboard()
    points = board.points_mm.astype(np.float64)
    seen = []
    while len(seen) < boards:
        z = rng.uniform(230, 420)
        about, tilt = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(12, 40))
        turn = cv2.Rodrigues(tilt * np.array([np.cos(about), np.sin(about), 0.0]))[0]
        origin = np.array([*(rng.uniform(-0.4, 0.4, 2) * z), z]) - turn @ points.mean(axis=0)
        pixel = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], origin, lens.matrix, np.array(lens.distortion))[0]
        if pixel.min() > 2 and pixel.max() < SIZE_PX - 3:
            seen.append((pixel + CORNER_NOISE_PX * rng.standard_normal(pixel.shape)).astype(np.float32))
    rms, matrix, distortion, turns, origins, sigma, _, _ = cv2.calibrateCameraExtended(
        [board.points_mm] * boards, seen, lens.size_px, None, None, flags=cv2.CALIB_FIX_K3
    )
    poses = tuple(
        BoardPose(k, cv2.Rodrigues(turns[k])[0], np.ravel(origins[k]), np.zeros(3), 0.01, 1e-5, float(rms))
        for k in range(boards)
    )
    sigma, distortion = np.ravel(sigma), np.ravel(distortion)
    estimate = type(lens)(
        lens.size_px,
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        tuple(float(k) for k in distortion[:5]),
    )
    noise = float(rms) / np.sqrt(2)
    return CameraCalibration(
        estimate, tuple(sigma[:2]), tuple(sigma[2:4]), tuple(sigma[4:9]), (noise, noise), poses, ()
    )


def rough_geometry(truth: RigModel) -> RigGeometry:
    """Planes as the paper's calibration leaves them: a tenth of a millimetre and some 0.3 mrad off."""
    normal = truth.frame.axes[2] + np.array([3e-4, -3e-4, 0.0])
    mirror = Plane(-normal / truth.frame.camera_mm[2] * 1.0003, np.zeros((3, 3)), 0.0, 0)
    a, b, c = truth.glass
    upright = np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    distance = upright @ truth.frame.camera_mm - c * upright[2]
    glass = Plane(-(upright @ truth.frame.axes) / distance * 1.0002, np.zeros((3, 3)), 0.0, 0)
    frame = reference_frame(mirror, camera_xy_mm=(-160.0, 0.0))
    return RigGeometry(mirror, glass, frame, 0.0, 0.0, 0.0, 180.0, 180.0, 0.01, {})


def facet_errors(model: RigModel, shown: list[Shown], offsets_mm: list[float]) -> np.ndarray:
    """Height in the middle (um) and slopes (urad) of each facet from its exact phases, minus the truth."""
    rows = []
    for facet in range(shown[0].trace.facet.max() + 1):
        seen = np.logical_and.reduce([eroded(one.reflected & (one.trace.facet == facet)) for one in shown])
        v, u = (place[:: max(1, seen.sum() // 300)] for place in np.nonzero(seen))
        points = shown[0].trace.point_mm[v, u]
        middle = points.mean(axis=0)
        design = np.column_stack([np.ones(len(points)), points[:, :2] - middle[:2]])
        true = np.linalg.lstsq(design, points[:, 2], rcond=None)[0]
        directions = model.frame.directions(rays_at(model.intrinsics, np.stack([u, v], axis=-1)))
        phases = [one.phase_rad[v, u] for one in shown]
        stages = [one.stage1_mm + offset for one, offset in zip(shown, offsets_mm, strict=True)]

        def misfit(plane: np.ndarray) -> np.ndarray:
            tilted = np.array([-plane[1], -plane[2], 1.0])
            camera = model.frame.camera_mm
            reach = (plane[0] + tilted[:2] @ middle[:2] - tilted @ camera) / (directions @ tilted)  # noqa: B023
            hit = camera + reach[:, None] * directions  # noqa: B023
            mirrored = directions - 2 * np.outer(directions @ tilted, tilted) / (tilted @ tilted)  # noqa: B023
            lit = [model.meet_glass(hit + stage * model.stage_axis, mirrored) for stage in stages]  # noqa: B023
            modelled = [model.phase_rad(points, on_glass=True) for points in lit]
            return np.concatenate([phase - own for phase, own in zip(phases, modelled, strict=True)])  # noqa: B023

        plane = least_squares(misfit, true + np.array([0.1, 1e-3, 1e-3]), x_scale=[1, 0.01, 0.01], diff_step=1e-6).x
        rows.append((plane - true) * [1e3, 1e6, 1e6])
    return np.array(rows)
