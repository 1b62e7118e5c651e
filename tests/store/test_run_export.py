import csv
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from plyfile import PlyData
from runs_on_disk import RECORD, entry, new_run, picture
from test_journal import largest_file

from irpmd_rig.store import DiskFull, ExportError, Optics, RunFolder, RunFolderError
from irpmd_rig.store.export import EXPORTS, SUFFIXES, export_run

DEPTH_MM = np.array([[0.1, np.nan, 0.3], [0.4, 0.5, 0.6]], dtype=np.float32)


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    optics = Optics(camera_serial="4711", size_px=(64, 64))
    folder = new_run(tmp_path / "runs", RECORD.model_copy(update={"optics": optics, "rig": {"name": "lab"}}))
    for index in (0, 1, 13):
        folder.write_frame(picture(index), entry(index, exposure_us=2500.0, bits=8, time="2026-11-22T10:00:00+01:00"))
    folder.write_frame(picture(4), entry(4, role="white", set=None, step=None, label="glass"))
    folder.close()
    results = folder.results
    results.write_array("depth_mm.npy", DEPTH_MM)
    results.write_map("depth_mm.tif", DEPTH_MM, "mm")
    results.write_points("points.ply", np.random.default_rng(0).random((5, 3)))
    results.write_table("steps.csv", [{"step": 1, "height_um": 99.5}])
    results.write_json("result.json", {"facets": 3})
    return folder


def strings(values: h5py.Dataset) -> list[str]:
    return list(values.asstr()[:])


def test_hdf5_holds_frames_and_how_they_were_taken(folder: RunFolder, tmp_path: Path) -> None:
    path = export_run(folder, "hdf5", tmp_path / "run.nxs.h5")
    with h5py.File(path) as file:
        camera, light = file["entry/instrument/camera"], file["entry/instrument/projector"]
        for row, index in enumerate((0, 1, 13, 4)):
            assert np.array_equal(camera["data"][row], picture(index))
        assert np.allclose(camera["count_time"][:3], 0.0025)
        assert camera["serial_number"].asstr()[()] == "4711"
        assert list(file["entry/instrument/stage1/value"]) == [0, 0, 40, 0]
        assert file["entry/instrument/stage1/value"].attrs["units"] == "mm"
        assert "stage2" not in file["entry/instrument"]
        assert list(light["set"]) == [0, 0, 0, -1]
        assert np.array_equal(light["fringe_count"], [64, 64, 64, np.nan], equal_nan=True)
        assert strings(light["role"]) == ["fringes"] * 3 + ["white"]
        assert strings(light["label"])[3] == "glass"


def test_hdf5_follows_nexus_from_the_root_to_the_default_plot(folder: RunFolder, tmp_path: Path) -> None:
    with h5py.File(export_run(folder, "hdf5", tmp_path / "run.nxs.h5")) as file:
        group, classes = file, []
        while True:
            classes.append(group.attrs["NX_class"])
            if "default" not in group.attrs:
                break
            group = group[group.attrs["default"]]
        assert classes == ["NXroot", "NXentry", "NXprocess", "NXdata"]
        signal = group[group.attrs["signal"]]
        assert np.array_equal(signal, DEPTH_MM, equal_nan=True)
        assert signal.attrs["units"] == "mm"
        assert list(group.attrs["axes"]) == ["row", "column"]
        assert [len(group[axis]) for axis in group.attrs["axes"]] == list(signal.shape)
        entry = file["entry"]
        assert entry["entry_identifier"].asstr()[()] == folder.id
        assert entry["start_time"].asstr()[()] == "2026-11-22T10:00:00+01:00"
        assert (entry["user/name"].asstr()[()], entry["sample/name"].asstr()[()]) == ("A. Person", "S-7")
        frames = entry["frames"]
        assert frames["data"] == entry["instrument/camera/data"]
        assert frames["data"].attrs["target"] == "/entry/instrument/camera/data"
        groups: list[h5py.Group] = []
        file.visititems(lambda _, item: groups.append(item) if isinstance(item, h5py.Group) else None)
        assert all("NX_class" in item.attrs for item in groups)


def test_a_run_without_results_shows_its_frames(tmp_path: Path) -> None:
    folder = new_run(tmp_path)
    folder.write_frame(picture(0), entry(0))
    folder.close()
    with h5py.File(export_run(folder, "hdf5", tmp_path / "run.h5")) as file:
        assert file["entry"].attrs["default"] == "frames"
        assert file["entry/frames"].attrs["signal"] == "data"


def test_a_run_without_frames_is_exported_too(tmp_path: Path) -> None:
    with h5py.File(export_run(new_run(tmp_path), "hdf5", tmp_path / "run.h5")) as file:
        assert "camera" not in file["entry/instrument"]


def test_the_other_formats(folder: RunFolder, tmp_path: Path) -> None:
    paths = {form: export_run(folder, form, tmp_path / f"out{SUFFIXES[form]}") for form in EXPORTS}
    assert len(PlyData.read(str(paths["ply"]))["vertex"]) == 5
    assert np.array_equal(tifffile.imread(paths["tiff"]), DEPTH_MM, equal_nan=True)
    assert not cv2.imread(str(paths["png"]), cv2.IMREAD_UNCHANGED)[0, 1].any()
    assert list(csv.DictReader(paths["csv"].read_text().splitlines())) == [{"step": "1", "height_um": "99.5"}]


def test_what_is_not_there_is_told(folder: RunFolder, tmp_path: Path) -> None:
    folder.results.clear()
    with pytest.raises(ExportError, match="reconstruct it first"):
        export_run(folder, "ply", tmp_path / "points.ply")
    with pytest.raises(ExportError, match="no export 'zarr'; there are hdf5, ply"):
        export_run(folder, "zarr", tmp_path / "x")
    with pytest.raises(ExportError, match="there is no folder"):
        export_run(folder, "csv", tmp_path / "missing" / "x")
    with pytest.raises(ExportError, match="is no file"):
        export_run(folder, "csv", tmp_path)
    assert not (tmp_path / "points.ply").exists()


def test_frames_of_two_sizes_cannot_be_one_array(folder: RunFolder, tmp_path: Path) -> None:
    folder.write_frame(picture(0, size_px=32), entry(0))
    folder.close()
    with pytest.raises(ExportError, match=r"\(32, 32\)"):
        export_run(folder, "hdf5", tmp_path / "run.h5")


def test_a_missing_frame_ends_the_export(folder: RunFolder, tmp_path: Path) -> None:
    folder.file(folder.manifest()[1].path).unlink()
    with pytest.raises(RunFolderError):
        export_run(folder, "hdf5", tmp_path / "run.h5")
    assert not list(tmp_path.glob("run.h5*"))


@pytest.mark.parametrize("limit_bytes", [0, 100, 3_000, 10_000, 20_000])
def test_hdf5_on_a_full_disk_is_a_typed_error_and_the_process_lives(
    folder: RunFolder, tmp_path: Path, limit_bytes: int
) -> None:
    with largest_file(limit_bytes), pytest.raises(DiskFull):
        export_run(folder, "hdf5", tmp_path / "run.h5")
    assert not list(tmp_path.glob("run.h5*"))
