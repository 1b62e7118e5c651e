"""The commands beside `serve`: an object's truth in a file, and a camera alone."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner
from world_client import WORLD

from drivers.protocols import CameraSettings
from drivers.registry import make
from sims.__main__ import app


def test_the_truth_of_an_object_in_a_file(tmp_path: Path) -> None:
    out = tmp_path / "truth.npz"
    arguments = ["truth", str(WORLD), "--object", "mirror_step_x", "--size-px", "256", "--seed", "3", "--out", str(out)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    with np.load(out) as truth:
        points, facet, steps_mm = truth["point_mm"], truth["facet"], truth["steps_mm"]
        assert points.shape == (256, 256, 3)
        assert int(truth["seed"]) == 3
        assert float(truth["d_mm"]) == 180.0
        assert truth["focal_px"] == pytest.approx([2355.03482 / 8, 2355.59838 / 8])
    # No facet of this object is tilted: its heights differ by the steps.
    heights = [points[facet == number, 2].mean() for number in range(facet.max() + 1)]
    assert np.diff(heights) == pytest.approx(steps_mm, abs=1e-6)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--object", "mirror_stop_x", "--out", "t.npz"), "there is no object 'mirror_stop_x'"),
        (("--object", "mirror_step_x", "--out", "/proc/t.npz"), "/proc/t.npz cannot be written"),
    ],
)
def test_a_truth_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], complaint: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["truth", str(WORLD), "--size-px", "64", *options])
    assert result.exit_code == 2
    assert complaint in result.stderr


@pytest.mark.parametrize("unpaced", [False, True])
def test_a_camera_alone_serves_random_pictures(tmp_path: Path, *, unpaced: bool) -> None:
    command = [sys.executable, "-m", "sims", "camera", str(tmp_path / "bench"), "--size-px", "64"]
    command += ["--unpaced"] * unpaced
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        producer = process.stdout.readline().strip()
        camera = make("camera", "harvesters", "camera", {"producer": producer})
        camera.open()
        camera.configure(CameraSettings(exposure_us=100.0, pixel_format="Mono10"))
        camera.arm(3)
        frames = [frame.image.copy() for frame in camera.frames(5)]
        camera.close()
        process.stdin.close()
        assert process.wait(30) == 0
    assert len({frame.tobytes() for frame in frames}) == 3
    assert 400 < np.mean(frames) < 620
    assert list((tmp_path / "bench").iterdir()) == []
