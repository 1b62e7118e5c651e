from datetime import timedelta
from pathlib import Path

import pytest
from runs_on_disk import QUEUED, succeeded

from irpmd_rig.store import Library, NotUsable, Optics, RunFolderError, RunNotFound, RunRecord, Store

OPTICS = {"camera_serial": "4711", "size_px": (2048, 2048), "intrinsics": "20260101-000000-abcdef"}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


@pytest.fixture
def library(store: Store) -> Library:
    return Library(store)


def test_calibrations_and_references_are_succeeded_runs_of_these_kinds(store: Store, library: Library) -> None:
    camera = succeeded(store, kind="calibrate-camera", name="november")
    reference = succeeded(store, kind="reference", optics=OPTICS, positions_mm=(0, 40))
    succeeded(store, kind="measure")
    store.create_run(RunRecord(kind="calibrate-plate"), QUEUED)
    assert [(item.id, item.kind, item.name) for item in library.calibrations()] == [
        (camera.id, "calibrate-camera", "november")
    ]
    (item,) = library.references()
    assert (item.id, item.positions_mm, item.optics) == (reference.id, (0, 40), Optics.model_validate(OPTICS))
    assert item.created is not None
    assert item.age_days(item.created + timedelta(days=3)) == pytest.approx(3)
    assert 0 <= (item.age_days() or 0) < 1


def test_one_of_each_kind_is_active_also_after_a_restart(store: Store, library: Library) -> None:
    first, second = (succeeded(store, kind="reference") for _ in range(2))
    camera = succeeded(store, kind="calibrate-camera")
    assert library.active("reference") is None
    for folder in (first, camera, second):
        assert library.activate(folder.id).active
    again = Library(Store(store.root))
    assert {item.id for item in again.references() if item.active} == {second.id}
    assert again.resolve("reference").id == second.id
    assert again.resolve("calibrate-camera", "active").id == camera.id
    assert again.resolve("reference", first.id).id == first.id


def test_what_cannot_serve_is_refused(store: Store, library: Library) -> None:
    measured, waiting = succeeded(store), store.create_run(RunRecord(kind="reference"), QUEUED)
    with pytest.raises(NotUsable, match="is a measure, not a"):
        library.activate(measured.id)
    with pytest.raises(NotUsable, match="has not succeeded: it is queued"):
        library.activate(waiting.id)
    with pytest.raises(NotUsable, match="is a calibrate-camera, not a reference"):
        library.activate(succeeded(store, kind="calibrate-camera").id, ("reference",))
    with pytest.raises(RunNotFound):
        library.activate("20260101-000000-abcdef")
    with pytest.raises(NotUsable, match="no reference is active"):
        library.resolve("reference")
    with pytest.raises(NotUsable, match="was to serve as reference"):
        library.resolve("reference", "../elsewhere")


def test_an_active_run_that_a_person_deleted_is_told(store: Store, library: Library) -> None:
    reference = succeeded(store, kind="reference")
    library.activate(reference.id)
    reference.path.rename(store.root / "moved")
    with pytest.raises(NotUsable, match=reference.id):
        library.resolve("reference")


@pytest.mark.parametrize("content", ["{", "[]", '{"reference": 3}'])
def test_a_damaged_list_of_active_runs_is_a_typed_error(store: Store, library: Library, content: str) -> None:
    (store.root / "active.json").write_text(content)
    with pytest.raises(RunFolderError, match=r"active\.json.*activate again"):
        library.resolve("reference")


def test_a_run_without_its_calibration_is_refused(store: Store, library: Library) -> None:
    folder = succeeded(store, kind="reference")
    library.activate(folder.id)
    folder.results.clear()
    said = f"run {folder.id}, a reference, has no calibration.json among its results: compute it again"
    for use in (lambda: library.activate(folder.id), lambda: library.resolve("reference", folder.id),
                lambda: library.resolve("reference")):  # fmt: skip
        with pytest.raises(NotUsable, match=said):
            use()
