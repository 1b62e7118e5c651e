"""From run folders alone to the steps of an object, in an aligned simulated rig."""

import csv
import json
import shutil

import numpy as np
import pytest
import tifffile
from plyfile import PlyData
from simulated_runs import NOMINAL_MM, SIZE_PX

from irpmd_rig.processing import FramesUnusable, ProcessingError
from irpmd_rig.processing.chain import Chain
from irpmd_rig.processing.frames import fringe_stations
from irpmd_rig.processing.phases import Phases
from irpmd_rig.processing.process import Processor, process, reconstruct
from irpmd_rig.store import RunFolder
from irpmd_rig.store.errors import StoreError
from irpmd_rig.store.results import Results


def test_the_steps_of_the_object_are_measured_within_their_uncertainty(chain):
    content = chain.content("measure")
    assert content["without_steps"] is None
    assert [step["name"] for step in content["steps"]] == ["1-2", "2-3", "3-4", "4-5"]
    for step, true_mm in zip(content["steps"], NOMINAL_MM, strict=True):
        assert abs(step["measured_mm"] - true_mm) < 4e-3 * step["uncertainty_um"]
        assert step["uncertainty_um"] < 60
        assert abs(step["deviation_um"]) < 4 * step["uncertainty_um"]
        parts = (step["random_um"], step["calibration_um"], step["alignment_um"])
        assert np.hypot.reduce(parts) == pytest.approx(step["uncertainty_um"])
    assert chain.processed["measure"].summary["steps_mm"] == content["measured_steps_mm"]


def test_the_calibrations_find_the_truth_within_their_uncertainty(chain):
    world = chain.runs.rig.world
    lens = chain.content("calibrate-camera")["intrinsics"]
    assert abs(lens["focal_px"][0] - world.camera.fc_px[0]) < 4 * lens["sigma_focal_px"][0]
    geometry = chain.content("calibrate-geometry")
    assert abs(geometry["d_mm"] - 180) < max(0.03, 4 * geometry["sigma_d_mm"])
    assert geometry["gamma_deg"] < 0.05
    assert chain.content("calibrate-plate")["order"] >= 3


def test_each_result_says_what_it_was_made_with(chain):
    ids = {kind: folder.id for kind, folder in chain.folders.items()}
    for kind, needs in {
        "calibrate-camera": [],
        "calibrate-plate": ["calibrate-camera"],
        "calibrate-geometry": ["calibrate-plate", "calibrate-camera"],
        "reference": ["calibrate-geometry", "calibrate-plate", "calibrate-camera"],
        "measure": ["calibrate-geometry", "calibrate-plate", "calibrate-camera", "reference"],
    }.items():
        content = chain.content(kind)
        assert content["run"] == ids[kind]
        assert content["uses"] == chain.processed[kind].uses == {need: ids[need] for need in needs}
        assert content["size_px"] == [SIZE_PX, SIZE_PX]
        assert "mm" in content["units"]
        assert content["camera_serial"] == "XM-0001"
        assert content["versions"]["irpmd-rig"]


def test_what_is_written_belongs_together(chain):
    results = chain.folders["measure"].results
    depth = results.read_array("depth_mm.npy")
    assert depth.shape == (SIZE_PX, SIZE_PX)
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(tifffile.imread(results.path("depth_mm.tif")), depth)
    vertices = PlyData.read(str(results.path("points.ply")))["vertex"]
    assert len(vertices) == np.isfinite(depth).sum() == chain.content("measure")["depth"]["pixels"]
    assert set(np.unique(vertices["facet"])) == set(range(6))
    with results.path("steps.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [float(row["measured_mm"]) for row in rows] == chain.content("measure")["measured_steps_mm"]
    assert set(chain.processed["measure"].files) == set(results.names())


def test_the_depth_map_is_told_of_before_all_else(chain):
    files = [file for _, _, file in chain.told if file]
    assert files[:2] == ["depth_mm.npy", "sigma_mm.npy"]
    assert files[-1] == "result.json"
    fractions = [fraction for _, fraction, _ in chain.told]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0
    assert fractions[-1] == 1


def test_a_reference_is_smooth_and_leaves_out_what_is_no_mirror(chain):
    arrays = chain.folders["reference"].results.read_arrays("arrays.npz")
    sprayed = chain.folders["calibrate-geometry"].results.read_arrays("arrays.npz")["sprayed"]
    for phase in arrays.values():
        known = np.isfinite(phase)
        assert 0.01 < known.mean() < 0.6
        assert not (known & sprayed).any()
    for station in chain.content("reference")["stations"]:
        assert station["coherent_rad"] < station["noise_rad"] < 0.03


def test_a_folder_can_be_computed_again(chain):
    folder = chain.folders["measure"]
    before = folder.results.read_array("depth_mm.npy")
    steps = chain.content("measure")["measured_steps_mm"]
    folder.results.clear()
    reconstruct(folder.path, chain.runs.library, lambda _: None, threads=2)
    np.testing.assert_array_equal(folder.results.read_array("depth_mm.npy"), before)
    assert chain.content("measure")["measured_steps_mm"] == pytest.approx(steps, abs=1e-9)


def test_a_folder_written_by_hand_gives_the_same_depth(chain, tmp_path):
    measured = chain.folders["measure"]
    (tmp_path / "run.yaml").write_text("kind: measure\nfringes: {counts: [64, 63, 56], steps: 4}\n")
    with (tmp_path / "manifest.jsonl").open("w") as manifest:
        for entry in measured.manifest():
            name = f"{entry.station}-{entry.set}-{entry.step}.tif"
            tifffile.imwrite(tmp_path / name, measured.read_frame(entry), compression="zlib")
            line = {key: getattr(entry, key) for key in ("station", "set", "step", "stage1_mm")}
            manifest.write(json.dumps({"path": name, **line}) + "\n")
    told = []
    process(RunFolder(tmp_path), chain.runs.library, lambda progress: told.append(progress.text), threads=2)
    results = Results(tmp_path / "results")
    np.testing.assert_array_equal(results.read_array("depth_mm.npy"), measured.results.read_array("depth_mm.npy"))
    # Nobody checked its frames before.
    assert sum("frames are checked" in text for text in told) == 2
    content = results.read_json("result.json")
    assert content["created"] is None
    assert content["camera_serial"] is None
    assert content["checks"][0]["says"] == "camera not known, not too old"
    assert content["positions"][0]["checked"] == "now"
    assert content["positions"][0]["exposure_us"] is None
    assert content["positions"][0]["stage1_measured"] is False


def test_a_free_sequence_has_nothing_to_compute(chain):
    text = "{kind: sequence, name: free, steps: [{do: show, pattern: white}, {do: capture, label: white}]}"
    processed = process(chain.runs.take(text), chain.runs.library, lambda _: None)
    assert processed.files == ()
    assert processed.summary == {"frames": 1}


def test_a_station_is_decoded_once_and_again_if_it_was_taken_again(chain, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path, ignore=shutil.ignore_patterns("results"))
    folder, processor = RunFolder(path), Processor()
    processor.decode(folder, chain.runs.library, 0)
    first = fringe_stations(folder.manifest(), "object")[0]
    phases = Phases()
    known = phases.at(folder, first)
    assert phases.at(folder, first) is known
    frames = [folder.read_frame(entry) for entry in first.entries]
    for entry in first.entries:
        (path / entry.path).unlink()
    processor.process(folder, chain.runs.library, lambda _: None)  # the phase is there, its frames are gone
    depth_mm = folder.results.read_array("depth_mm.npy")
    np.testing.assert_array_equal(depth_mm, chain.folders["measure"].results.read_array("depth_mm.npy"))
    folder.supersede(first.entries)
    for frame, entry in zip(frames, first.entries, strict=True):
        folder.write_frame(frame, entry.model_copy(update={"attempt": 2}))
    folder.close()
    again = phases.at(folder, fringe_stations(folder.manifest(), "object")[0])
    assert again is not known
    np.testing.assert_array_equal(again.phase_rad, known.phase_rad)


def test_half_of_the_results_never_stays(chain, tmp_path, monkeypatch):
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path, ignore=shutil.ignore_patterns("results"))
    folder = RunFolder(path)

    def full(*_):
        assert "depth_mm.npy" in folder.results.names()
        raise StoreError("no space left")

    monkeypatch.setattr(Results, "write_points", full)
    with pytest.raises(ProcessingError, match="no space left"):
        process(folder, chain.runs.library, lambda _: None)
    assert folder.results.names() == ()


def test_the_modulation_of_the_white_plate_is_not_kept(chain):
    for kind, label, kept in (("calibrate-plate", "plate", False), ("measure", "object", True)):
        folder = chain.folders[kind]
        known = Phases().at(folder, fringe_stations(folder.manifest(), label)[0])
        assert (known.modulation_map_dn is not None) is kept
        assert known.sigma_rad > 0


def test_old_and_new_results_never_lie_side_by_side(chain, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path)
    folder = RunFolder(path)
    entries = folder.manifest()
    for name in ("steps.csv", "result.json"):
        assert name in folder.results.names()
    # What cannot be computed at all leaves everything as it was.
    hidden = folder.file(entries[-1].path).rename(path / "hidden.tif")
    with pytest.raises(FramesUnusable):
        process(folder, chain.runs.library, lambda _: None)
    assert "result.json" in folder.results.names()
    hidden.rename(path / entries[-1].path)

    def fail(progress):
        if progress.text == "facets and steps":
            left.extend(folder.results.names())
            raise InterruptedError

    left: list[str] = []
    with pytest.raises(InterruptedError):
        process(folder, chain.runs.library, fail)
    assert left == ["depth_mm.npy", "sigma_mm.npy"]
    assert folder.results.names() == ()  # half of it would pass for a result


def test_a_calibration_that_was_computed_again_is_read_again(chain):
    record, library = chain.folders["measure"].record(), chain.runs.library
    results = chain.folders["reference"].results
    before = Chain(record, library).stamp
    assert Chain(record, library).stamp == before
    results.write_json("calibration.json", results.read_json("calibration.json"))
    after = Chain(record, library).stamp
    assert [kind for (kind, *_), other in zip(before, after, strict=True) if other not in before] == ["reference"]


def test_what_a_killed_computation_left_is_taken_away_by_the_next(chain, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path)
    folder = RunFolder(path)
    (path / "results" / "result.json").unlink()
    (path / "manifest.jsonl").rename(tmp_path / "manifest.jsonl")
    with pytest.raises(FramesUnusable, match=r"has no manifest\.jsonl: which frame is what is not known; write it"):
        process(folder, chain.runs.library, lambda _: None)
    assert folder.results.names() == ()
    (path / "manifest.jsonl").write_text("")
    with pytest.raises(FramesUnusable, match=r"manifest\.jsonl names no frame"):
        process(folder, chain.runs.library, lambda _: None)


def test_the_papers_filter_makes_the_map_smoother_and_leaves_the_steps(chain, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(chain.folders["measure"].path, path, ignore=shutil.ignore_patterns("results"))
    folder = RunFolder(path)
    folder.amend(recipe={**folder.record().recipe, "phase_filter": True})
    process(folder, chain.runs.library, lambda _: None)
    filtered, plain = folder.results.read_json("result.json"), chain.content("measure")
    assert filtered["depth"]["stated_noise_of_a_pixel_um"] < 0.7 * plain["depth"]["stated_noise_of_a_pixel_um"]
    for one, other in zip(filtered["steps"], plain["steps"], strict=True):
        assert abs(one["measured_mm"] - other["measured_mm"]) < 2e-3 * other["uncertainty_um"]
