"""The command from options to files: a short scheme, really rendered and computed."""

import io
import json
from itertools import islice

import pytest
from rich.console import Console

from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.recipes.reading import read_recipe
from irpmd_rig.reproduce import command, scheme
from irpmd_rig.reproduce.command import Request, reproduce


class ShortScheme(scheme.Scheme):
    """Calibrations and the mirror step by the paper's recipe."""

    def tasks(self):
        return islice(super().tasks(), 5)


@pytest.mark.timeout(600)
def test_a_short_reproduction_writes_page_figures_numbers_and_recipes(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "Scheme", ShortScheme)
    monkeypatch.setattr(scheme, "_PLATES", (0.0, 40.0, 80.0, 120.0, 160.0, 200.0))
    told = io.StringIO()
    content = reproduce(Request(tmp_path, 384, 2, ("tables", "figures")), Console(file=told))
    assert "5 runs" in told.getvalue()
    assert content == json.loads((tmp_path / "numbers.json").read_text())
    ways = {way["way"]: way for way in content["table_2"]["ways"]}
    assert ways["ours"]["largest_error_um"] < ways["its method here"]["largest_error_um"]
    html = (tmp_path / "report.html").read_text()
    assert ways["ours"]["run"] in html
    figures = {path.stem for path in (tmp_path / "figures").iterdir()}
    assert {"table_2", "figure_6a", "figure_6b", "figure_7abc", "figure_7d", "figure_8", "figure_8_error"} <= figures
    assert (tmp_path / "tables" / "table_1.csv").read_text().startswith(",the paper")
    recipes = sorted((tmp_path / "recipes").iterdir())
    assert [path.name[:2] for path in recipes] == ["01", "02", "03", "04", "05"]
    assert all(read_recipe(path.read_text()) for path in recipes)
    left = [path for path in (tmp_path / "runs").rglob("*") if path.suffix in {".npy", ".npz", ".ply", ".tif"}]
    assert left == []
    assert all(
        (tmp_path / "runs" / "data" / run["run"] / "results" / "report.html").exists() for run in content["runs"]
    )


@pytest.mark.parametrize(
    ("request_", "complaint"),
    [
        (Request(None, parts=("pictures",)), "--only takes tables, figures, repeatability, sweeps .* not pictures"),
        (Request(None, size_px=100), "--size-px takes 384 to 4096, not 100"),
        (Request(None, seed=-1), "--seed takes a whole number"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_taken(request_, complaint):
    with pytest.raises(MeasurementError, match=complaint):
        reproduce(request_, Console(file=io.StringIO()))


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MeasurementError, match="--out must name a folder that can be made"):
        reproduce(Request(tmp_path / "file"), Console(file=io.StringIO()))
