"""Calibrate a rig and measure with it, as a script of the lab does. The daemon has to run: irpmd-rig serve sim."""

import sys
from collections.abc import Callable
from pathlib import Path

from irpmd_rig.client import Client, Event, Run

CALIBRATIONS = ("calibrate-camera", "calibrate-plate", "calibrate-geometry", "reference")

MEASURE = """
kind: measure
name: {subject} at 0 and 40 mm
object: {subject}
positions_mm: [0, 40]
compare: [depth-equation]
"""


def calibrate(rig: Client, on_event: Callable[[Event], None] | None = None) -> dict[str, Run]:
    """Calibrate from scratch by the recipes that ship; returns the runs by recipe."""
    return {recipe: rig.carry_out(recipe, activate=True, on_event=on_event) for recipe in CALIBRATIONS}


def measure(rig: Client, subject: str, folder: Path, on_event: Callable[[Event], None] | None = None) -> Run:
    """Measure an object and save its results in a folder; returns the run."""
    folder.mkdir(exist_ok=True)
    run = rig.carry_out(MEASURE.format(subject=subject), on_event=on_event)
    for name in run.results:
        rig.download(run.id, f"results/{name}", folder)
    return run


if __name__ == "__main__":
    subject = sys.argv[1]
    with Client() as rig:
        calibrate(rig)
        run = measure(rig, subject, Path(subject))
        for step in rig.result(run.id)["steps"]:
            print(f"{step['name']}: {step['measured_mm']:.4f} mm, one sigma {step['uncertainty_um']:.1f} um")
