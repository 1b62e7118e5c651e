"""Fringes along y go with those along x at the same stage position, in whatever order they were taken."""

import pytest

from irpmd_rig.processing.errors import FramesUnusable
from irpmd_rig.processing.frames import FringeStation, at_same_positions
from irpmd_rig.store import ManifestEntry


def station(number: int, stage1_mm: float, orientation: str) -> FringeStation:
    entry = ManifestEntry(station=number, label="mirror", role="fringes", orientation=orientation, stage1_mm=stage1_mm)
    return FringeStation(number, "mirror", orientation, (64.0, 63.0, 56.0), 4, (entry,))


def test_stations_are_paired_by_position_not_by_order() -> None:
    along_x = [station(0, 0.0, "x"), station(1, -40.0, "x"), station(2, 40.0, "x")]
    along_y = [station(3, 40.004, "y"), station(4, 0.0, "y"), station(5, -40.0, "y"), station(6, -80.0, "y")]
    assert [one.number for one in at_same_positions(along_x, along_y, 0.01)] == [4, 5, 3]


def test_a_position_without_fringes_along_y_is_named() -> None:
    along_x = [station(0, 0.0, "x"), station(1, -40.0, "x")]
    along_y = [station(0, 0.0, "y"), station(2, -60.0, "y")]
    with pytest.raises(FramesUnusable, match="no fringes along y at -40 mm: the nearest are at -60 mm"):
        at_same_positions(along_x, along_y, 0.01)
