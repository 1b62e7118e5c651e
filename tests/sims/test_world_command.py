"""`python -m sims`: checking a world and timing it."""

import json
from pathlib import Path

from typer.testing import CliRunner

from sims.__main__ import app

RUN = CliRunner()


def test_check_accepts_the_shipped_worlds(worlds: Path) -> None:
    for path in sorted(worlds.glob("*.yaml")):
        result = RUN.invoke(app, ["check", str(path)])
        assert result.exit_code == 0
        assert "valid" in result.stdout


def test_check_says_what_is_wrong_and_where(worlds: Path, tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text((worlds / "ideal.yaml").read_text().replace("seed: 1", "sead: 1"))
    result = RUN.invoke(app, ["check", str(path)])
    assert result.exit_code == 2
    assert "unknown key; did you mean 'seed'?" in result.stderr
    assert "Traceback" not in result.output


def test_render_bench_prints_one_json_object(worlds: Path, tmp_path: Path) -> None:
    text = (worlds / "misaligned.yaml").read_text()
    path = tmp_path / "small.yaml"
    path.write_text(text.replace("size_px: [2048, 2048]", "size_px: [512, 256]"))
    result = RUN.invoke(app, ["render-bench", "--json", "--runs", "3", "--world", str(path)])
    assert result.exit_code == 0
    rows = json.loads(result.stdout)["rows"]
    assert len(rows) == 3
    for row in rows:
        assert {"name", "value", "unit", "baseline", "baseline_value", "ratio", "must", "aim"} == set(row)
        assert row["value"] > 0
        assert row["baseline_value"] > 0
