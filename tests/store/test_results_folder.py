from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from plyfile import PlyData
from test_journal import largest_file

from irpmd_rig.store import DiskFull, ExportError, FileNotInRun, Results, RunFolderError
from irpmd_rig.store.formats import coloured_picture, encode_png, grey_picture


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results(tmp_path / "results")


def test_json_and_arrays_come_back(results: Results) -> None:
    depth = np.array([[1.5, np.nan]], dtype=np.float32)
    results.write_json("result.json", {"steps_um": [1.0, 2.0]})
    results.write_array("depth_mm.npy", depth)
    results.write_arrays("arrays.npz", {"a": depth, "b": np.arange(3)})
    assert results.names() == ("arrays.npz", "depth_mm.npy", "result.json")
    assert results.read_json("result.json") == {"steps_um": [1.0, 2.0]}
    assert np.array_equal(results.read_array("depth_mm.npy"), depth, equal_nan=True)
    assert np.array_equal(results.read_arrays("arrays.npz")["b"], [0, 1, 2])


def test_what_is_written_is_what_other_programs_read(results: Results) -> None:
    depth = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)
    assert np.array_equal(tifffile.imread(results.write_map("depth_mm.tif", depth, "mm")), depth)
    path = results.write_table("steps.csv", [{"step": "1-2", "height_um": 99.5}, {"step": "2-3", "height_um": 50.25}])
    assert path.read_text() == "step,height_um\n1-2,99.5\n2-3,50.25\n"
    assert results.write_table("none.csv", []).read_text() == ""


def test_points_are_read_by_plyfile_without_the_unknown_ones(results: Results) -> None:
    points = np.arange(12, dtype=np.float64).reshape(2, 2, 3)
    points[0, 1, 2] = np.nan
    facet = np.array([[1, 2], [3, 4]], dtype=np.int64)
    path = results.write_points("points.ply", points, {"facet": facet})
    vertices = PlyData.read(str(path))["vertex"]
    assert np.allclose(np.column_stack([vertices[axis] for axis in "xyz"]), points.reshape(-1, 3)[[0, 2, 3]])
    assert list(vertices["facet"]) == [1, 3, 4]
    with pytest.raises(ExportError, match="a property"):
        results.write_points("points.ply", points, {"facet": facet[:1]})


def test_a_result_that_does_not_fit_leaves_the_old_one(results: Results) -> None:
    results.write_array("depth_mm.npy", np.zeros(10))
    # An array goes to the file past Python's own writing: its errors carry no cause.
    with largest_file(10_000):
        for write in (
            lambda: results.write_array("depth_mm.npy", np.zeros(10_000)),
            lambda: results.write_arrays("arrays.npz", {"a": np.zeros(10_000)}),
            lambda: results.write_map("depth_mm.tif", np.zeros((100, 100)), "mm"),
            lambda: results.write_points("points.ply", np.zeros((10_000, 3))),
        ):
            with pytest.raises(DiskFull):
                write()
    assert [path.name for path in results.folder.iterdir()] == ["depth_mm.npy"]
    assert results.read_array("depth_mm.npy").shape == (10,)


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "x.part", "a b", "x" * 200])
def test_a_result_has_a_plain_name(results: Results, name: str) -> None:
    with pytest.raises(RunFolderError, match="no name for a result"):
        results.write_text(name, "x")
    with pytest.raises(FileNotInRun):
        results.path(name)


def test_numbers_that_json_does_not_have_are_refused(results: Results) -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        results.write_json("result.json", {"depth": float("nan")})


def test_what_cannot_be_read_is_a_typed_error(results: Results) -> None:
    results.write_text("result.json", "[1]")
    results.write_text("depth_mm.npy", "not an array")
    results.write_array("list.npz", np.zeros(3))
    results.write("objects.npy", lambda stream: np.save(stream, np.array([{}]), allow_pickle=True))
    with pytest.raises(RunFolderError, match="not a JSON object"):
        results.read_json("result.json")
    for name in ("depth_mm.npy", "objects.npy"):
        with pytest.raises(RunFolderError, match="not readable"):
            results.read_array(name)
    with pytest.raises(RunFolderError, match="not NpzFile"):
        results.read_arrays("list.npz")
    with pytest.raises(FileNotInRun):
        results.read_json("other.json")


def test_clearing_away_what_an_earlier_attempt_computed(results: Results) -> None:
    results.clear()
    results.write_text("a.txt", "a")
    results.clear()
    assert results.names() == ()


def test_links_and_folders_that_somebody_put_there_are_no_results(results: Results) -> None:
    results.write_text("a.txt", "a")
    (results.folder / "elsewhere.txt").symlink_to("/etc/hostname")
    (results.folder / "folder").mkdir()
    assert results.names() == ("a.txt",)
    results.clear()
    assert results.names() == ()


def test_of_a_coloured_picture_only_the_unknown_is_black() -> None:
    picture = coloured_picture(np.array([[0.0, 1.0], [2.0, np.nan]]))
    assert picture.shape == (2, 2, 3)
    assert (picture.max(axis=2) > 50).tolist() == [[True, True], [True, False]]


def test_grey_pictures() -> None:
    values = np.array([[0.0, 1.0], [2.0, np.nan]])
    assert np.array_equal(grey_picture(values, 0, 2), [[1, 128], [255, 0]])
    assert not grey_picture(np.full((2, 2), np.nan)).any()
    assert cv2.imdecode(np.frombuffer(encode_png(np.zeros((2, 2), np.uint16)), np.uint8), -1).dtype == np.uint16
    with pytest.raises(ExportError, match="a PNG picture"):
        encode_png(np.zeros((2, 2)))
