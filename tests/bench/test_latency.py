"""The bench of the depth map's latency measures a measurement that comes out right."""

import numpy as np
import pytest

from irpmd_rig.bench import latency
from irpmd_rig.bench.measurement import HEIGHTS_MM, SteppedMirror, calibrated, measured
from irpmd_rig.processing.process import process
from irpmd_rig.store import Store


@pytest.mark.parametrize("bits", [8, 10])
def test_the_stepped_mirror_in_closed_form_is_measured(tmp_path, bits):
    store, mirror = Store(tmp_path), SteppedMirror(512, bits)
    library = calibrated(store, mirror)
    done = process(measured(store, mirror), library, lambda _: None, threads=2)
    np.testing.assert_allclose(done.summary["steps_mm"], np.diff(HEIGHTS_MM), atol=0.02)
    store.close()


def test_both_kinds_of_frames_are_measured_beside_what_was_not_done_ahead(monkeypatch):
    monkeypatch.setattr(latency, "_MOVE_S", 0.2)
    rows = latency.run(size_px=320, repeats=1)
    assert [row.name.split(", ")[1] for row in rows] == ["8 bits", "10 bits"]
    for row in rows:
        assert row.unit == "ms"
        assert 0 < row.value < 5000
        assert row.sense == "value at most"
    assert (rows[0].must, rows[0].aim) == (300.0, 100.0)
