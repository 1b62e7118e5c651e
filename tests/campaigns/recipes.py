"""Recipes of the campaigns: short free sequences, and the chain of calibrations in its smallest size."""

import shutil
from pathlib import Path

from tests.campaigns.lab import Daemon, Lab

NOMINAL_MM = (3.9868, 7.0248, 5.0062, 6.0986)
CHAIN = (
    "{kind: calibrate-camera, name: camera, poses: 12}",
    "{kind: calibrate-plate, name: plate, positions_mm: [0, 40, 80, 120, 160, 200]}",
    "{kind: calibrate-geometry, name: geometry}",
    "{kind: reference, name: reference, positions_mm: [0, 40]}",
)
# So few pixels are hardly enough for a facet of its own; the paper's method finds all of them.
MEASURE = (
    "{kind: measure, name: a step, object: mirror_step_y, method: depth-equation, "
    f"nominal_steps_mm: {list(NOMINAL_MM)}}}"
)

_BEGINNING = """kind: sequence
name: stations
retries: {retries}
exposure_us: {exposure_us}
trigger: {trigger}
fringes: {{counts: [8, 7], steps: 3}}
steps:
  - {{do: prompt, text: Place the mirror., subject: mirror}}
  - {{do: show, pattern: {pattern}}}
"""
_STATION = """  - {{do: move, stage: {stage}, position_mm: {position_mm}}}
  - {{do: wait, time_s: {wait_s}}}
  - {{do: capture, label: mirror}}
"""


def stations(
    *positions_mm: float,
    pattern: str = "fringes",
    retries: int = 1,
    stage: str = "stage1",
    trigger: str = "hardware",
    exposure_us: float = 2000.0,
    wait_s: float = 0.0,
    more: str = "",
) -> str:
    """A free sequence that takes frames of the mirror at each position of a stage, after a wait there."""
    text = _BEGINNING.format(pattern=pattern, retries=retries, trigger=trigger, exposure_us=exposure_us)
    each = (_STATION.format(stage=stage, position_mm=place, wait_s=wait_s) for place in positions_mm)
    return text + "".join(each) + more


def calibrate(daemon: Daemon) -> None:
    """Take and activate whatever a measurement needs."""
    for text in CHAIN:
        run = daemon.carry_out(text)
        assert run.state == "succeeded", (run.kind, run.reason, run.detail)
        if run.kind == "reference":
            daemon.client.activate_reference(run.id)
        else:
            daemon.client.activate_calibration(run.id)


def use_calibration(lab: Lab, kept: Path | None) -> None:
    """Let a lab without runs have a calibration: one that was kept, or a new one."""
    if kept is not None and kept.is_dir():
        shutil.copytree(kept, lab.root)
        return
    with lab.daemon() as daemon:
        calibrate(daemon)
    if kept is not None:
        shutil.copytree(lab.root, kept)
