"""A run folder with the results of a measurement, written by hand: two facets with a step, and what is said of it."""

from pathlib import Path

import numpy as np

from irpmd_rig.core import fringe_images
from irpmd_rig.store import Fringes, ManifestEntry, RunFolder, RunRecord
from irpmd_rig.store.record import write_record

SIZE_PX = 96
COUNTS, STEPS = (64.0, 63.0, 56.0), 4
STEP_MM = 4.0
NOISE_UM = 20.0
WINDOW = slice(20, 80), slice(30, 70)


def heights(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth map, points (H, W, 3) and facets (H, W): planes at 0 and 4 mm with a gap between."""
    rows, columns = np.mgrid[:SIZE_PX, :SIZE_PX]
    labels = np.zeros((SIZE_PX, SIZE_PX), np.int32)
    labels[20:48, 30:70], labels[52:80, 30:70] = 1, 2
    z = np.where(labels == 2, STEP_MM, 0.0) + 1e-3 * NOISE_UM * np.random.default_rng(seed).normal(size=labels.shape)
    depth = np.where(labels > 0, z, np.nan).astype(np.float32)
    points = np.stack([0.5 * columns, 0.5 * rows, depth], axis=-1)
    return depth, points, labels


def result(method: str = "facets") -> dict:
    """What `result.json` says of it."""
    step = {
        "name": "1-2",
        "measured_mm": 4.0012,
        "mean_height_difference_mm": 4.001,
        "at_mm": [25.0, 25.0],
        "uncertainty_um": 0.94,
        "random_um": 0.6,
        "calibration_um": 0.72,
        "alignment_um": None,
        "nominal_mm": 4.0,
        "deviation_um": 1.2,
    }
    facets = [
        {
            "facet": k + 1,
            "kind": "plane",
            "centre_mm": [25.0, 17.0 + 16 * k],
            "height_mm": STEP_MM * k,
            "sigma_height_um": 0.4,
            "slope_rad": [0.0, 0.0],
            "pixels": 1120,
            "flat": True,
            "chi2_per_dof": 1.03,
        }
        for k in range(2)
    ]
    position = {"station": 0, "stage1_mm": 0.0, "stage1_measured": True, "checked": "when taken", "checks": {}}
    return {
        "kind": "measure",
        "run": "a-run",
        "created": "2026-11-22T10:00:00+00:00",
        "computed": "2026-11-22T10:01:00+00:00",
        "camera_serial": "XM-0001",
        "size_px": [SIZE_PX, SIZE_PX],
        "uses": {"calibrate-geometry": "geometry"},
        "versions": {"irpmd-rig": "0.1.0", "numpy": "2.4.6"},
        "method": method,
        "method_because": "the recipe names it",
        "counts": list(COUNTS),
        "steps_a_set": STEPS,
        "positions": [position, {**position, "station": 1, "stage1_mm": 40.0}],
        "d_mm": 180.0,
        "sigma_d_mm": 0.002,
        "delta_d_mm": 40.0,
        "sigma_delta_d_mm": 0.0014,
        "depth": {"file": "depth_mm.npy", "pixels": 2240, "fraction_of_picture": 0.24, "noise_of_a_pixel_um": NOISE_UM},
        "facets": facets,
        "step_definition": "step i-j: along the reference's normal",
        "steps": [step],
        "without_steps": None,
        "methods": {
            method: {"steps": [step], "chi2_per_dof": 1.03, "noise_of_a_pixel_um": NOISE_UM},
            "depth-equation": {"steps": [{**step, "measured_mm": 3.98, "uncertainty_um": 22.0}]},
        },
        "not_computed": {"generalised": "there is no reference"},
        "checks": [{"name": "calibration", "passed": True, "says": "of this camera, not too old"}],
    }


def write_measured_run(folder: Path, content: dict | None, name: str = "a step") -> RunFolder:
    """Write run, frames and results; without results if there is no content."""
    folder.mkdir(parents=True)
    fringes = Fringes(counts=COUNTS, steps=STEPS)
    record = RunRecord(kind="measure", name=name, sample="M-17", operator="Anna", fringes=fringes)
    write_record(record, folder / "run.yaml")
    run = RunFolder(folder)
    images = fringe_images(COUNTS, STEPS, (SIZE_PX, SIZE_PX))
    for station, stage1_mm in enumerate((0.0, 40.0)):
        entry = ManifestEntry(station=station, stage1_mm=stage1_mm, exposure_us=5000.0, bits=8)
        for number, step in np.ndindex(len(COUNTS), STEPS):
            run.write_frame(images[number][step], entry.model_copy(update={"set": number, "step": step}))
    run.flush()
    run.close()
    if content is not None:
        depth, points, labels = heights()
        run.results.write_array("depth_mm.npy", depth)
        run.results.write_array("sigma_mm.npy", np.where(np.isfinite(depth), np.float32(1e-3 * NOISE_UM), np.nan))
        run.results.write_points("points.ply", points, {"facet": labels})
        run.results.write_json("result.json", content)
    return run
