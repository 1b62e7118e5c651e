"""Speed of the simulated camera, measured by the simulator itself: it is never imported, it is run."""

from __future__ import annotations

import json
import subprocess

from irpmd_rig.bench.timing import Row
from irpmd_rig.programs import module_command, module_environment


def run() -> list[Row]:
    """Time one noisy 2048 x 2048 frame, pose known, beside a plain numpy rendering.

    Raises
    ------
    OSError
        If the simulator cannot be run.
    """
    ended = subprocess.run(
        module_command("sims", "render-bench", "--json"),
        capture_output=True,
        text=True,
        check=False,
        env=module_environment(),
    )
    if ended.returncode:
        raise OSError(f"python -m sims render-bench failed: {ended.stderr.strip()}")
    return [Row(**row, sense="value at most") for row in json.loads(ended.stdout)["rows"]]
