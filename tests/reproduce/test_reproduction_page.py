"""The page of a reproduction: every table and figure of the paper is there, each number with its run."""

import json
import re

import numpy as np
import pytest
from found_results import ERRORS_UM, RANDOM_UM, found_results

from irpmd_rig.report.html import drawings, render
from irpmd_rig.reproduce.beyond import SWEEPS, repeatability_content, repeated, sweep_content, sweep_section
from irpmd_rig.reproduce.page import numbers, page
from irpmd_rig.reproduce.scheme import FAN, PARTS
from irpmd_rig.reproduce.tables import lens_content, step_tables
from irpmd_rig.reproduce.taken import PLAIN


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    return found_results(tmp_path_factory.mktemp("worlds"))


def test_the_page_has_every_table_and_figure_of_the_paper(results):
    whole, tables = page(results, PARTS, ["runs/data/1/results/report.html"])
    names = {picture.name for picture in whole.pictures}
    assert {"table_2", "table_3_infrared", "table_3_visible"} <= names
    for figure in ("6a", "6b", "7abc", "7d", "8", "9a", "9b", "10a", "10b", "11a", "11b", "12a", "12b", "13a", "13b"):
        assert f"figure_{figure}" in names
    assert {"repeatability", "stage_tilt", "read_noise", "fringe_count"} <= names
    assert {"table_1", "repeatability", "stage_tilt", "read_noise", "fringe_count"} == set(tables)
    html = render(whole, drawings(whole))
    assert "Mirror step, largest error: 21.3 µm in the paper" in html
    assert 'href="runs/data/1/results/report.html"' in html
    assert not re.search(r'(src|href)="https?:', html)


def test_numbers_are_json_without_nan_and_name_their_runs(results):
    content = numbers(results, PARTS)
    json.dumps(content, allow_nan=False)
    runs = {entry["run"] for entry in content["runs"]}
    ours = [way for way in content["table_3_visible"]["ways"] if way["way"] != "the paper"]
    assert len(ours) == 4
    assert {way["run"] for way in ours} <= runs
    assert {line["run"] for line in content["table_1"]} <= runs
    assert {point["run"] for points in content["sweeps"].values() for point in points} <= runs


def test_only_what_was_asked_for_is_there(tmp_path):
    whole, tables = page(found_results(tmp_path, ("tables",)), ("tables",), [])
    headings = [section.heading for section in whole.sections]
    assert headings == [
        "Table 1: camera",
        "Table 2: mirror step",
        "Table 3: fan",
        "The paper's errata",
        "Runs and recipes",
    ]
    assert set(tables) == {"table_1"}


def test_steps_that_were_not_found_are_said_to_be_missing(tmp_path):
    results = found_results(tmp_path, missed=FAN)
    whole, _ = page(results, PARTS, [])
    table = next(table for table in step_tables(results) if table.name == "table_3_infrared")
    assert [column.steps.errors_um for column in table.columns[1:]] == [()] * 4
    assert numbers(results, PARTS)["table_3_infrared"]["ways"][1]["largest_error_um"] is None
    assert "nan" not in render(whole, {picture.name: "<svg/>" for picture in whole.pictures})


def test_table_1_stands_beside_the_truth_at_the_camera_s_size(results):
    lens = {line["name"]: line for line in lens_content(results)}
    assert lens["fx (px)"]["true"] == pytest.approx(2355.03482 / 2)
    assert lens["cx (px)"]["true"] == pytest.approx((1016.92767 + 0.5) / 2 - 0.5)
    assert lens["k1"]["true"] == -0.13744
    assert lens["fx (px)"]["paper"] == 2355.03482


def test_both_methods_stand_beside_the_paper(results):
    table = step_tables(results)[0]
    by_way = {column.name: column.steps.rms_um for column in table.columns}
    assert next(iter(by_way)) == "the paper"
    assert by_way["its method here"] == pytest.approx(ERRORS_UM[PLAIN], abs=1)
    assert by_way["ours"] == pytest.approx(ERRORS_UM["facets"], abs=1)


def test_repetitions_are_held_against_the_stated_random_part(results):
    steps = repeated(results, "facets")
    assert [step.values_um.size for step in steps] == [20] * 4
    pooled = np.sqrt(np.mean([step.deviation_um**2 for step in steps]))
    assert pooled == pytest.approx(RANDOM_UM, rel=0.25)
    assert np.mean([step.mean_um for step in steps]) == pytest.approx(ERRORS_UM["facets"], abs=0.3)
    assert len(repeatability_content(results)["runs"]) == 20


@pytest.mark.parametrize("sweep", SWEEPS, ids=lambda sweep: sweep.use)
def test_a_sweep_has_a_point_for_each_run_and_method(results, sweep):
    taken = results.all_of(sweep.use)
    assert len(taken) >= 4
    assert len(sweep_content(results, sweep)) == 4 * len(taken)
    section, table = sweep_section(results, sweep)
    assert section.heading == sweep.heading
    assert [row[-1] for row in table.rows] == [one.run_id for one in taken]


def test_a_sweep_by_noise_is_drawn_over_the_noise_that_was_found(results):
    noise = next(sweep for sweep in SWEEPS if sweep.use == "read-noise")
    assert [noise.x(one) for one in results.all_of("read-noise")] == pytest.approx([14.7, 58.8, 117.6, 176.4])
