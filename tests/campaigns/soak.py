"""Measurements back to back: `python -m tests.campaigns.soak --runs 50`.

Memory of daemon, camera's and computing process stays within 5 % and their open files stay the same, from the third
run on: until then caches fill.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

from tests.campaigns import lab as labs
from tests.campaigns.kills import SIGMAS
from tests.campaigns.on_disk import complaints
from tests.campaigns.recipes import MEASURE, use_calibration
from tests.campaigns.report import Report

GROWTH = 0.05
WARM = 3
END_BOUND_S = 120.0


def campaign(runs: int, calibration: Path | None = None) -> Report:
    """Make a campaign of a size."""
    report = Report("soak", runs, 0)
    memory: list[int] = []
    descriptors: list[dict[str, int]] = []
    durations_s: list[float] = []
    with labs.lab() as lab:
        use_calibration(lab, calibration)
        with lab.daemon() as daemon:
            for number in range(runs):
                began_s = time.monotonic()
                run = daemon.carry_out(MEASURE, END_BOUND_S)
                durations_s.append(time.monotonic() - began_s)
                if run.state != "succeeded":
                    report.blame("undefined", (number, run.state, run.reason, run.detail))
                    continue
                steps = daemon.client.result(run.id)["steps"]
                if any(abs(step["deviation_um"]) > SIGMAS * step["uncertainty_um"] for step in steps):
                    report.blame("false_successes", (number, steps))
                if wrong := complaints(lab.root / run.id):
                    report.blame("false_successes", (number, wrong))
                if unrest := lab.unrest():
                    report.blame("left_on", (number, unrest))
                daemon.client.delete_run(run.id)
                memory.append(daemon.memory_bytes())
                descriptors.append(daemon.descriptors())
    report.figures |= {
        "memory_mb": [round(memory[index] / 1e6, 1) for index in (0, min(WARM, len(memory) - 1), -1)],
        "descriptors": [descriptors[min(WARM, len(descriptors) - 1)], descriptors[-1]],
        "median_s": round(statistics.median(durations_s), 2),
    }
    if runs > 2 * WARM:
        _compare(report, memory, descriptors)
    return report


def _compare(report: Report, memory: list[int], descriptors: list[dict[str, int]]) -> None:
    """What a long series has to leave as it was."""
    few = max(1, (len(memory) - WARM) // 4)
    early, late = statistics.median(memory[WARM : WARM + few]), statistics.median(memory[-few:])
    report.figures["memory_growth"] = round(late / early - 1.0, 4)
    if late > (1.0 + GROWTH) * early:
        report.blame("left_on", f"memory grew from {early / 1e6:.1f} to {late / 1e6:.1f} MB")
    # A connection of the client's may just have been opened or closed.
    more = {name: count for name, count in descriptors[-1].items() if count > descriptors[WARM].get(name, 0) + 2}
    if more:
        report.blame("left_on", f"open files {descriptors[WARM]} became {descriptors[-1]}")


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--runs", type=int, default=50)
    given = asked.parse_args()
    return campaign(given.runs).tell()


if __name__ == "__main__":
    sys.exit(main())
