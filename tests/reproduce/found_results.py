"""What a reproduction found, made up: every measurement of a scheme, with errors that a test chooses."""

from pathlib import Path

import numpy as np

from irpmd_rig.bench.accuracy_truth import Compared, Truth
from irpmd_rig.bench.accuracy_worlds import Change, write_world
from irpmd_rig.demo.paper import TABLE_2, TABLE_3
from irpmd_rig.report.shape import Shape
from irpmd_rig.reproduce.results import Entry, Results
from irpmd_rig.reproduce.scheme import FAN, PARTS, STEP, Scheme
from irpmd_rig.reproduce.taken import PLAIN, Steps, Taken, Views

RANDOM_UM = 0.5
ERRORS_UM = {PLAIN: 30.0, "depth-equation": 28.0, "generalised": 2.0, "triangulation": 1.5, "facets": 1.0}
ACTUAL = {STEP: TABLE_2.actual_mm, FAN: TABLE_3.actual_mm, "freeform": ()}
SIZE = 40


def views(rng) -> Views:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    labels = np.where(rows < SIZE // 2, 1, 2).astype(np.int32)
    z = (labels * 4.0).astype(np.float32)
    shape = Shape(
        (slice(10, 10 + SIZE), slice(20, 20 + SIZE)), z, None,
        np.stack([columns, rows, z], axis=-1).astype(np.float32), labels, rng.normal(0, 10, z.shape).astype(np.float32),
    )  # fmt: skip
    return Views(
        shape.window, rng.integers(0, 255, (3, 4, SIZE, SIZE)), rng.uniform(-3, 3, (3, SIZE, SIZE)),
        np.linspace(0, 100, SIZE * SIZE).reshape(SIZE, SIZE), shape, rng.normal(0, 10, z.shape),
    )  # fmt: skip


def steps(actual_mm, error_um, rng) -> Steps:
    errors = tuple(float(error_um + RANDOM_UM * rng.normal()) for _ in actual_mm)
    count = len(actual_mm)
    measured = tuple(true + 1e-3 * error for true, error in zip(actual_mm, errors, strict=True))
    return Steps(measured, errors, (1.2,) * count, (RANDOM_UM,) * count)


def found_results(folder: Path, parts=PARTS, *, missed: str = "", seed: int = 1) -> Results:
    """Results of all tasks of a scheme; of the object `missed` no step was found."""
    rng = np.random.default_rng(seed)
    runs, measurements, calibrations = [], [], {}
    for number, task in enumerate(Scheme(seed, folder, parts).tasks()):
        run_id = f"20261122-{number:06d}-abcdef"
        runs.append(Entry(task, run_id, f"recipes/{number:02d}.yaml"))
        if not task.subject:
            calibrations.setdefault(task.key, (run_id, calibration(task.key)))
            continue
        actual = () if task.subject == missed else ACTUAL[task.subject]
        by_method = {name: steps(actual, error, rng) for name, error in ERRORS_UM.items()} if actual else {}
        figures = dict.fromkeys(("step_chi2", "pixel_um", "pixel_chi2"), np.nan)
        compared = {
            name: Compared((), (), shape_um=3.0, absolute_um=4.0, pistons_um=(1.0, 6.0), **figures)
            for name in ("depth-equation", "facets")
        }
        content = {"counts": [64.0, 63.0, 56.0], "positions": [{"sigma_rad": 0.0147 * max(1.0, task.at)}]}
        seen = views(rng) if task.use in ("paper", "precise") and "figures" in parts else None
        measurements.append(Taken(task, run_id, content, by_method, compared, seen))
    world = write_world(folder / "world.yaml", seed, Change())
    truth = Truth(np.zeros((2, 2)), (), TABLE_2.actual_mm, 180.0, (1.0, 1.0))
    return Results(seed, 1024, world, truth, calibrations, measurements, runs, 123.0)


def calibration(key: str) -> dict:
    """What a calibration says of itself, as far as the reproduction reads it."""
    if key == "camera":
        lens = {
            "focal_px": [1177.6, 1177.9], "principal_point_px": [508.4, 509.2],
            "distortion": [-0.1374, 0.1478, -0.00004, -0.00016, 0.0], "pixel_error_px": [0.03, 0.031],
            "sigma_focal_px": [0.05, 0.05], "sigma_principal_point_px": [0.06, 0.06],
            "sigma_distortion": [1e-4, 1e-3, 1e-5, 1e-5, 0.0],
        }  # fmt: skip
        return {"intrinsics": lens, "boards": [{}] * 30}
    return {"d_mm": 180.004, "sigma_d_mm": 0.01, "d_seen_mean_mm": 180.13, "rig_model": {"d_mm": 180.0004}}
