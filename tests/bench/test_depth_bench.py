import numpy as np
import pytest

from irpmd_rig.bench.depth import DECODE, depth_of, mirror_frames, paper_rig, run
from irpmd_rig.core.reconstruction.triangulation import rig_tables


def test_the_frames_are_those_of_a_mirror_at_height_zero():
    tables = rig_tables(paper_rig(256))
    frames = [mirror_frames(tables, position_mm) for position_mm in (0.0, 40.0)]
    window = (slice(96, 160), slice(64, 128))
    depth = depth_of(frames, tables, window, slope_rounds=0)
    pulls = depth.depth_mm / depth.sigma_mm
    assert np.isfinite(pulls).mean() > 0.99
    assert np.nanmean(np.abs(pulls) < 4) > 0.999
    assert np.nanstd(pulls[np.abs(pulls) < 4]) == pytest.approx(1.0, abs=0.1)


def test_each_row_of_the_depth_stands_beside_the_decoding():
    rows = run(size_px=64, repeats=1)
    assert [(row.sense, row.must, row.aim) for row in rows] == [
        ("at most", 2.5, 1.5),
        ("at most", 2.5, 1.5),
        ("at most", 2.5, 1.5),
    ]
    for row in rows:
        assert row.baseline == DECODE
        assert row.ratio == pytest.approx(row.value / row.baseline_value)
