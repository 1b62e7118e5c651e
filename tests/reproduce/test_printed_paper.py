"""The paper's printed figures: its errata are found by what the tables themselves say."""

import pytest

from irpmd_rig.demo.paper import TABLE_2, TABLE_3
from irpmd_rig.reproduce.printed import PRINTED_ERRORS_MM, TABLE_1, TABLE_3_VISIBLE, errata, misprints


def test_misprints_are_the_two_known_rows_of_table_3():
    assert misprints(TABLE_3) == (0, 1)
    assert misprints(TABLE_2) == misprints(TABLE_3_VISIBLE) == ()


def test_errors_are_measured_minus_actual_not_what_is_printed():
    assert TABLE_3.error_um(0) == pytest.approx(2.74)
    assert TABLE_3.error_um(1) == pytest.approx(-4.33)
    assert PRINTED_ERRORS_MM[TABLE_3][:2] == (0.00574, 0.00447)


def test_errata_say_what_is_printed_and_what_is_used():
    said = errata()
    assert "row 1-2: the printed error is 0.00574 mm; measured minus actual is 0.00274 mm" in said[0]
    assert "row 2-3: the printed error is 0.00447 mm; measured minus actual is 0.00433 mm" in said[1]
    assert any("Equation (5)" in text for text in said)
    assert any("13 x 11 inner corners" in text for text in said)


def test_visible_light_has_the_fan_s_actual_steps():
    assert TABLE_3_VISIBLE.actual_mm == TABLE_3.actual_mm
    assert max(abs(TABLE_3_VISIBLE.error_um(k)) for k in range(5)) == pytest.approx(36.12)


def test_table_1_names_the_camera_s_eight_numbers():
    assert [line.name for line in TABLE_1] == ["fx (px)", "fy (px)", "cx (px)", "cy (px)", "k1", "k2", "p1", "p2"]
    assert all(line.uncertainty > 0 for line in TABLE_1)
