"""A measurement from a run's frames: depth maps, points, facets and steps, by one method or several."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.core.reconstruction.views import DepthMap
from irpmd_rig.processing.errors import FramesUnusable, ProcessingError, Refused
from irpmd_rig.processing.estimates import MethodResult, by_facets, by_pixels
from irpmd_rig.processing.frames import FringeStation
from irpmd_rig.processing.job import Job
from irpmd_rig.processing.methods import PixelDepth, depth_equation, generalised, known_rig, triangulated
from irpmd_rig.processing.object_views import ObjectViews, nothing_seen, object_views
from irpmd_rig.processing.optics import Optics
from irpmd_rig.processing.phases import check_station
from irpmd_rig.processing.regions import Window, bounding_box
from irpmd_rig.processing.report import Measured, MethodFiles, result_content, steps_table
from irpmd_rig.processing.seen_once import seen_once
from irpmd_rig.processing.values import ProcessedRun
from irpmd_rig.recipes.models import Method
from irpmd_rig.store.results import RESULT

# Of the chosen method, or of the one that it begins with.
_FIRST = MethodFiles("depth_mm.npy", "sigma_mm.npy")


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """What a measurement is computed from."""

    job: Job
    optics: Optics
    seen: ObjectViews

    def places(self) -> tuple[int, ...]:
        """Places of the stage positions in the reference; raises Refused."""
        if self.optics.references is None:
            raise Refused(self.job.chain.without_reference or "there is no reference", "make one, and activate it")
        return self.job.chain.reference_positions(self.seen.read_mm)

    def depth(self, method: Method) -> PixelDepth:
        """Depth by a method, or of facets the one that they begin with; raises ProcessingError or MeasurementError."""
        if method == "depth-equation":
            filtered, threads = self.job.chain.wishes.phase_filter, self.job.threads
            found = depth_equation(self.optics, self.seen, self.places(), filtered=filtered, threads=threads)
        elif method == "generalised":
            found = generalised(self.optics, self.seen, self.places())
        else:
            found = triangulated(self.optics, self.seen)
        known = bounding_box(np.isfinite(found.maps.depth_mm))
        if known is None:
            raise nothing_seen()
        return found.cut(known)

    def result(self, method: Method, depth: PixelDepth) -> MethodResult:
        """Facets and steps by a method on its depth."""
        if method != "facets":
            return by_pixels(method, depth)
        wishes, facts = self.job.chain.wishes, self.job.facts.calibration
        views = self.seen.cut(depth.window)
        return by_facets(depth, views, known_rig(self.optics), psf_px=facts.blur_px, max_chi2=wishes.max_chi2)


def measure_run(job: Job, optics: Optics) -> ProcessedRun:
    """Measure an object from the fringes labelled ``object`` at two or more positions of stage 1.

    The depth map is written first; everything else follows.

    Raises
    ------
    FramesUnusable
        If frames are missing or fail their checks.
    Refused
        If calibrations or reference do not fit.
    ProcessingError
        If no pixel has a depth.
    MeasurementError
        As the methods of `irpmd_rig.core.reconstruction`.
    """
    method, _ = job.chain.method
    first = _pixel_method(method)
    stations = _stations(job)
    job.plan(len(stations) + 3 + len(job.chain.wishes.compare))
    run = _Run(job, optics, object_views(job, optics, stations))
    job.step("depth")
    depth = run.depth(first)
    job.begin_results()
    _write_maps(run, depth.maps, depth.window, _FIRST)
    checked = [check_station(job.folder, station, job.step) for station in stations]
    job.step("facets and steps")
    chosen = run.result(method, depth)
    others, not_computed = _compared(run, method, depth)
    results = {method: chosen, **others}
    files = {name: _FIRST if name == first else _files(name) for name in results}
    for name, result in results.items():
        if name != first:
            _write_maps(run, result.maps, result.window, files[name])
    _write_rest(run, depth, chosen)
    once = seen_once(run.seen, optics)
    facts = Measured(run.seen, once, depth, _FIRST, results, files, not_computed, tuple(checked))
    job.folder.results.write_json(RESULT, result_content(job, optics, facts))
    job.wrote(RESULT)
    return job.finished(
        method=method,
        depth_pixels=int(np.count_nonzero(np.isfinite(depth.maps.depth_mm))),
        depth_noise_um=1e3 * chosen.noise_mm,
        facets=len(chosen.facets),
        steps_mm=[step.height_mm for step in chosen.steps],
        sigma_steps_um=[step.combined_um for step in chosen.steps],
        without_steps=chosen.without_steps or None,
        calibration_is_off="; ".join(job.chain.off) or None,
    )


def _compared(run: _Run, method: Method, depth: PixelDepth) -> tuple[dict[Method, MethodResult], dict[Method, str]]:
    """Results of the methods that the recipe compares, and why others have none."""
    depths = {_pixel_method(method): depth}
    results: dict[Method, MethodResult] = {}
    not_computed: dict[Method, str] = {}
    for other in run.job.chain.wishes.compare:
        run.job.step(f"{other}, to compare")
        pixel = _pixel_method(other)
        try:
            if other != method:
                if pixel not in depths:
                    depths[pixel] = run.depth(pixel)
                results[other] = run.result(other, depths[pixel])
        except (ProcessingError, MeasurementError) as error:
            not_computed[other] = str(error)
    return results, not_computed


def _pixel_method(method: Method) -> Method:
    """Method of the depth map with which a method begins."""
    return "triangulation" if method == "facets" else method


def _files(method: Method) -> MethodFiles:
    name = method.replace("-", "_")
    return MethodFiles(f"depth_{name}_mm.npy", f"sigma_{name}_mm.npy")


def _stations(job: Job) -> tuple[FringeStation, ...]:
    stations = job.stations("object")
    if len(stations) < 2:
        raise FramesUnusable(
            f"the object was taken at {len(stations)} stage positions; a depth takes two or more",
            "measure at two positions",
        )
    if len({(s.counts, s.steps) for s in stations}) > 1:
        raise FramesUnusable("the positions differ in fringe counts or phase steps", "measure again")
    job.chain.check_fringes(stations[0].counts)
    if job.chain.method_needs_reference:
        job.chain.reference_positions([station.stage1_mm for station in stations])
    return stations


def _write_maps(run: _Run, maps: DepthMap, window: Window, files: MethodFiles) -> None:
    """Write a depth map and its sigma, of the whole picture: NaN outside the window."""
    shape = run.seen.phases[0].phase_rad.shape
    for name, values in ((files.depth, maps.depth_mm), (files.sigma, maps.sigma_mm)):
        whole = np.full(shape, np.nan, np.float32)
        whole[window] = values
        run.job.folder.results.write_array(name, whole)
        run.job.wrote(name)


def _write_rest(run: _Run, depth: PixelDepth, chosen: MethodResult) -> None:
    """Write points, a map for other programs and the step table of the chosen method."""
    job, results = run.job, run.job.folder.results
    job.step("points and maps")
    points = depth.frame.points_mm(depth.maps.depth_mm.astype(np.float64), depth.rays())
    whole = np.full(run.seen.phases[0].phase_rad.shape, np.nan, np.float32)
    whole[depth.window] = depth.maps.depth_mm
    results.write_map("depth_mm.tif", whole, "mm")
    job.wrote("depth_mm.tif")
    properties: dict[str, NDArray[np.generic]] = {"facet": chosen.labels, "sigma_mm": depth.maps.sigma_mm}
    results.write_points("points.ply", points, properties)
    job.wrote("points.ply")
    results.write_table("steps.csv", steps_table(chosen, job.record.nominal_steps_mm))
    job.wrote("steps.csv")
