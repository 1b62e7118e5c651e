"""The command line: bad input ends in one line and exit status 2, never in a traceback."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

WORLDS = Path(__file__).parent.parent / "configs" / "worlds"


def irpmd_rig(*arguments, folder):
    return subprocess.run(
        [sys.executable, "-m", "irpmd_rig", *map(str, arguments)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=380,
        check=False,
    )


def refused(*arguments, folder):
    ended = irpmd_rig(*arguments, folder=folder)
    assert ended.returncode == 2, ended
    assert "Traceback" not in ended.stderr
    assert ended.stdout == ""
    return ended.stderr


def test_without_a_command_it_helps(tmp_path):
    ended = irpmd_rig("--help", folder=tmp_path)
    assert ended.returncode == 0
    assert "demo" in ended.stdout
    assert "bench" in ended.stdout


def test_worlds_lists_what_ships(tmp_path):
    listed = irpmd_rig("worlds", folder=tmp_path).stdout
    for path in WORLDS.glob("*.yaml"):
        assert path.stem in listed


def test_an_unknown_world_names_the_shipped_ones(tmp_path):
    assert "misaligned" in refused("demo", "--world", "nowhere.yaml", folder=tmp_path)


def test_an_unknown_object_names_the_known_ones(tmp_path):
    says = refused("demo", "--object", "teapot", folder=tmp_path)
    assert "teapot" in says
    assert "mirror_step_y" in says


def test_an_unknown_key_of_a_world_is_placed_and_the_nearest_named(tmp_path):
    text = (WORLDS / "aligned.yaml").read_text(encoding="utf-8")
    broken = tmp_path / "broken.yaml"
    broken.write_text(text.replace("psf_px:", "psf_pxl:"), encoding="utf-8")
    says = refused("demo", "--world", broken, folder=tmp_path)
    line = 1 + text[: text.index("psf_px:")].count("\n")
    assert f"broken.yaml:{line}:" in says
    assert "did you mean 'psf_px'" in says


@pytest.mark.parametrize("size", [0, 100, 100_000])
def test_an_impossible_camera_size_is_refused(size, tmp_path):
    assert "--size-px" in refused("demo", "--size-px", size, folder=tmp_path)


def test_a_folder_that_cannot_be_made_is_said_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    assert "file" in refused("demo", "--out", "file/results", folder=tmp_path)


def test_an_unknown_benchmark_is_refused(tmp_path):
    ended = irpmd_rig("bench", "sleep", folder=tmp_path)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr


def test_bench_render_prints_one_json_object(tmp_path):
    ended = irpmd_rig("bench", "render", "--json", folder=tmp_path)
    assert ended.returncode == 0, ended.stderr
    for row in json.loads(ended.stdout)["rows"]:
        assert row["value"] > 0


def test_a_negative_seed_is_refused(tmp_path):
    assert "seed" in refused("demo", "--seed", "-1", folder=tmp_path)


def test_a_stage_that_cannot_reach_the_second_position_is_said(tmp_path):
    text = (WORLDS / "aligned.yaml").read_text(encoding="utf-8")
    short = tmp_path / "short.yaml"
    short.write_text(text.replace("travel_mm: [-80.0, 220.0]", "travel_mm: [-80.0, 20.0]"), encoding="utf-8")
    assert "stage1" in refused("demo", "--world", short, "--size-px", 320, folder=tmp_path)


def test_the_help_is_fast_because_it_loads_nothing_that_measures(tmp_path):
    loads = "import sys, irpmd_rig.cli; print(*sys.modules)"
    ended = subprocess.run(
        [sys.executable, "-c", loads], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert not {"numpy", "numba", "cv2", "scipy", "fastapi", "pydantic", "h5py"} & set(ended.stdout.split())


def test_an_address_that_is_none_is_refused(tmp_path):
    (tmp_path / "token").write_text("token")
    assert "address" in refused("runs", "--url", "nowhere", "--token", "token", folder=tmp_path)
