"""The bench of the depth map's latency measures a measurement that comes out right."""

import numpy as np
import pytest

from irpmd_rig.bench import latency
from irpmd_rig.bench.measurement import HEIGHTS_MM, SteppedMirror, calibrated, measured
from irpmd_rig.processing.process import process
from irpmd_rig.store import Store


@pytest.mark.parametrize(
    ("bits", "method", "within_mm"), [(8, None, 0.005), (10, None, 0.005), (8, "triangulation", 0.02)]
)
def test_the_stepped_mirror_in_closed_form_is_measured(tmp_path, bits, method, within_mm):
    store, mirror = Store(tmp_path), SteppedMirror(512, bits)
    library = calibrated(store, mirror)
    done = process(measured(store, mirror, method), library, lambda _: None, threads=2)
    assert done.summary["method"] == (method or "facets")
    np.testing.assert_allclose(done.summary["steps_mm"], np.diff(HEIGHTS_MM), atol=within_mm)
    store.close()


def test_the_glass_in_the_frames_tells_where_the_stage_stood(tmp_path):
    store, mirror = Store(tmp_path), SteppedMirror(512)
    folder, library = measured(store, mirror, "triangulation"), calibrated(store, mirror)
    process(folder, library, lambda _: None)
    for position in folder.results.read_json("result.json")["positions"]:
        assert position["stage1_by_the_glass_mm"] == pytest.approx(position["stage1_mm"], abs=0.002)
    store.close()


def test_both_kinds_of_frames_are_measured_beside_what_was_not_done_ahead(monkeypatch):
    monkeypatch.setattr(latency, "_MOVE_S", 0.2)
    rows = latency.run(size_px=320, repeats=1)
    assert [row.name.split(", ", 1)[1] for row in rows] == ["8 bits", "10 bits", "8 bits, by depth-equation"]
    for row in rows:
        assert row.unit == "ms"
        assert 0 < row.value < 5000
        assert row.sense == "value at most"
    assert (rows[0].must, rows[0].aim) == (300.0, 100.0)
