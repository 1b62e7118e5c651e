"""Cached kernels must not outlive the code that they call."""

import shutil
import subprocess
import sys
from pathlib import Path

from sims import compiled

_ASK = (
    "import numpy as np; from sims.camera_rays import _rays; from numba import config;"
    "out = np.empty((2, 2, 2)); _rays(0, 2, np.array([1, 1, 0, 0, 0, 0, 0, 0, 0.0]), out);"
    "print(out[1, 1, 0], sum(_rays.stats.cache_hits.values()))"
)


def test_a_kernel_is_compiled_again_when_a_file_it_calls_changes(tmp_path: Path) -> None:
    package = tmp_path / "sims"
    shutil.copytree(Path(compiled.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))

    def ask() -> str:
        done = subprocess.run([sys.executable, "-c", _ASK], cwd=tmp_path, check=True, capture_output=True, text=True)
        return done.stdout.strip()

    assert ask() == "1.0 0"
    assert ask() == "1.0 1"
    # Another file than the one the kernel stands in.
    (package / "texture.py").write_text((package / "texture.py").read_text() + "\n# changed\n")
    assert ask() == "1.0 0"
