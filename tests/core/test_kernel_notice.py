"""The first call says that it compiles; later processes find the result in the cache and say nothing."""

import os
import subprocess
import sys

KERNEL = """
from numba import njit
from irpmd_rig.core._kernel_notice import announce_compilation

@njit(cache=True)
def double(x):
    return 2 * x

announce_compilation(double, "the test kernel")
"""
CALL = "import announced_kernel; assert announced_kernel.double(4) == 8; assert announced_kernel.double(5) == 10"


def test_compilation_is_announced_once_on_standard_error(tmp_path):
    (tmp_path / "announced_kernel.py").write_text(KERNEL)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = [
        subprocess.run([sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, check=True).stderr
        for _ in range(2)
    ]
    assert said == ["compiling the test kernel (a few seconds, once; cached afterwards)\n", ""]
