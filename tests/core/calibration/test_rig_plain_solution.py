"""The self-calibration against an independent solution: formulas written out, scipy's own optimizer, single pixels."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from irpmd_rig.core.calibration.rig_calibration import REGIONS
from irpmd_rig.core.calibration.self_cells import Cells
from irpmd_rig.core.calibration.self_fit import fit_unknowns
from irpmd_rig.core.calibration.self_start import first_guess
from irpmd_rig.core.calibration.self_unknowns import unknowns_about
from irpmd_rig.core.rig_model import RigModel
from tests.core.calibration.rig_scene import POSITIONS_MM, PROJECTOR, SIGMA_RAD, scene_of, turned_world

SIGMA_MEAN_RAD = SIGMA_RAD / 4
SPRAYED, GLASS = REGIONS.index("sprayed"), REGIONS.index("glass")
# Camera pitch, roll and height; glass; stage; projector's place, angles, focal length, centre and k1.
SCALE = np.array([0.01, 0.01, 1, 0.01, 0.01, 1, 0.01, 0.01, 10, 10, 10, 0.01, 0.01, 0.01, 100, 10, 0.1])


def near(truth: RigModel) -> np.ndarray:
    """Where the plain solution begins: millimetres and milliradians off."""
    lens = truth.projector
    across, _, view = lens.axes
    angles = Rotation.from_matrix(np.column_stack([across, np.cross(-view, across), -view])).as_euler("xyz")
    camera = [np.arccos(-truth.frame.axes[2, 2]), 0.0, truth.frame.camera_mm[2]]
    projector = [*lens.centre_mm, *angles, lens.focal_px[0], lens.principal_point_px[0], lens.distortion[0]]
    return np.array([*camera, *truth.glass, *truth.stage_axis[:2], *projector]) + 0.1 * SCALE


def sample(scene, pixels: int) -> Cells:
    """Single pixels of every region of every view, as if they were cells."""
    rows = []
    for number, view in enumerate(scene.views):
        for region, name in enumerate(REGIONS):
            v, u = np.nonzero(view.region(name) & np.isfinite(view.phase_rad))
            pick = np.linspace(0, len(v) - 1, pixels).astype(int)
            rows += [(number, region, u[k], v[k], view.phase_rad[v[k], u[k]]) for k in pick]
    rows = np.array(rows)
    view, region, zero = rows[:, 0].astype(int), rows[:, 1].astype(int), np.zeros(len(rows), dtype=int)
    return Cells(view, region, zero, zero, zero, rows[:, 2:4], rows[:, 4], np.full(len(rows), SIGMA_MEAN_RAD), 4)


def columns(numbers, lit):
    """Projector columns that light points (n, 3) of the world."""
    x, y, z, about_x, about_y, about_z, focal, centre, k1 = numbers[8:]
    turned = (lit - [x, y, z]) @ Rotation.from_euler("xyz", [about_x, about_y, about_z]).as_matrix()
    across, along = turned[:, 0] / -turned[:, 2], turned[:, 1] / turned[:, 2]
    return centre + focal * across * (1 + k1 * (across**2 + along**2))


def lit_by(numbers, rays, stage_mm, region):
    """Points of the world at which the light of each pixel left the projector's screen, glass or spray."""
    pitch, roll, height, slope_x, slope_y, glass_mm, axis_x, axis_y = numbers[:8]
    look = np.array([np.sin(pitch), 0.0, -np.cos(pitch)])
    right = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
    axes = Rotation.from_rotvec(roll * look).apply(np.stack([right, np.cross(look, right), look]))
    lines = rays @ axes
    world = stage_mm[:, None] * np.array([axis_x, axis_y, -np.sqrt(1 - axis_x**2 - axis_y**2)])
    camera = np.array([-160.0, 0.0, height])
    mirror = camera - lines * (height / lines[:, 2])[:, None]
    start = world + np.where((region == GLASS)[:, None], camera, mirror)
    onward = np.where((region == GLASS)[:, None], lines, lines * [1, 1, -1])
    above = start[:, 2] - slope_x * start[:, 0] - slope_y * start[:, 1] - glass_mm
    closing = onward[:, 2] - slope_x * onward[:, 0] - slope_y * onward[:, 1]
    reach = np.where(region == SPRAYED, 0.0, -above / closing)
    return start + reach[:, None] * onward


def test_the_same_rig_from_a_plain_solution() -> None:
    scene = scene_of(turned_world(11), 11, sigma_rad=SIGMA_MEAN_RAD, stage_noise_mm=0.0)
    cells = sample(scene, 60)
    stages, lens = np.array(POSITIONS_MM), scene.truth.intrinsics
    stage_mm = stages[cells.view]
    seen = cv2.undistortPoints(
        cells.pixel.reshape(-1, 1, 2), lens.matrix, np.array(lens.distortion), criteria=(3, 50, 1e-14)
    )
    rays = np.column_stack([seen.reshape(-1, 2), np.ones(len(cells))])

    def misfit(numbers):
        column = columns(numbers, lit_by(numbers, rays, stage_mm, cells.region))
        return (2 * np.pi * 64 * (column + 0.5) / 1024 - cells.phase_rad) / SIGMA_MEAN_RAD

    plain = least_squares(misfit, near(scene.truth), x_scale=SCALE, loss="huber", f_scale=3.0, ftol=1e-11, xtol=1e-11)

    guess = first_guess(cells, stages, lens, scene.geometry, PROJECTOR)
    exact = np.diag(np.full(8, 1e-9) ** 2)
    unknowns = unknowns_about(guess, np.array([125.0, 0.0, 180.0]), exact, np.full(4, 1e-9))
    root = unknowns.prior_root.copy()
    for name in ("k2", "p1", "p2"):  # the plain solution has k1 only
        place = unknowns.names.index(f"projector.{name}")
        root[place, place] = 1e9
    ours = fit_unknowns(cells, stage_mm, replace(unknowns, prior_root=root), unknowns.start)
    model = unknowns.model(ours.values)

    sigmas = dict(zip(unknowns.names, np.sqrt(np.diag(ours.covariance())), strict=True))
    pairs = {
        "camera.inclination": (ours.values[unknowns.names.index("camera.inclination")], plain.x[0]),
        "camera.height": (model.frame.camera_mm[2], plain.x[2]),
        "glass.slope_x": (model.glass[0], plain.x[3]),
        "glass.slope_y": (model.glass[1], plain.x[4]),
        "glass.height": (model.glass[2], plain.x[5]),
        "stage.axis_x": (model.stage_axis[0], plain.x[6]),
        "stage.axis_y": (model.stage_axis[1], plain.x[7]),
        "projector.k1": (model.projector.distortion[0], plain.x[16]),
        "projector.cx": (model.projector.principal_point_px[0], plain.x[15]),
    }
    assert ours.settled
    for name, (mine, other) in pairs.items():
        assert abs(mine - other) < 0.1 * sigmas[name], name
