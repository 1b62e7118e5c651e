"""kill -9 at random moments of a measurement: `python -m tests.campaigns.kills --kills 50`.

Three times in four the daemon is killed, else its camera's or its computing process. After each it is looked whether
every frame that was durable still is, whether the state is defined, whether the rig is at rest once the daemon was
started again, and whether a retry completes with the right steps.
"""

import argparse
import random
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from irpmd_rig.client import ClientError
from tests.campaigns import lab as labs
from tests.campaigns.faults import tail
from tests.campaigns.lab import Lab, TooLate
from tests.campaigns.on_disk import complaints, durable_frames, lost_frames
from tests.campaigns.recipes import MEASURE, use_calibration
from tests.campaigns.report import Report

END_BOUND_S = 90.0
# Of the steps, in their own stated uncertainties.
SIGMAS = 5.0
HELPERS = ("camera", "processing")
EXPLAINED = {
    "camera": ({"succeeded", "failed"}, {None, "device_lost"}),
    "processing": ({"succeeded", "failed"}, {None, "reconstruction_failed"}),
    "daemon": ({"queued", "interrupted", "succeeded"}, {None, "daemon_restarted"}),
}


class Kills:
    """A lab with a calibration, and the kills made in it."""

    def __init__(self, lab: Lab, report: Report, seed: int) -> None:
        self.lab, self.report = lab, report
        self.chance = random.Random(seed)
        self._stack = ExitStack()
        self.start()
        # Once for the caches, once for the time that it takes.
        for _ in range(2):
            run_id = self.daemon.submit(MEASURE)
            self.daemon.resume()
            began_s = time.monotonic()
            run = self.daemon.ended(run_id, END_BOUND_S)
            self.typical_s = time.monotonic() - began_s
            assert run.state == "succeeded", run.detail
            assert not self.wrong_steps(run_id)

    def close(self) -> None:
        """End the daemon."""
        self._stack.close()

    def start(self) -> None:
        """Start a daemon in the place of the one that is there, if it is."""
        self.close()
        self.daemon = self._stack.enter_context(self.lab.daemon())

    def kill(self) -> None:
        """One run, one kill, and what comes after."""
        victim = self.chance.choice(HELPERS) if self.chance.random() < 0.25 else "daemon"
        wait_s = self.chance.uniform(0.0, 0.95 * self.typical_s)
        told = f"{victim} after {wait_s:.2f} s"
        self.report.count(f"killed_{victim}")
        run_id = self.daemon.submit(MEASURE)
        self.daemon.resume()
        time.sleep(wait_s)
        if victim == "daemon":
            self.daemon.kill()
            durable = durable_frames(self.lab.root / run_id)
            self.start()
            if unrest := self.lab.unrest():
                self.report.blame("left_on", (told, unrest))
        else:
            durable = self._of_helper(victim, run_id)
        self._look(run_id, durable, victim, told)

    def _of_helper(self, victim: str, run_id: str) -> dict[str, str]:
        helper = self.daemon.helpers().get(victim)
        if helper is not None:
            helper.kill()
        durable = durable_frames(self.lab.root / run_id)
        self.daemon.ended(run_id, END_BOUND_S)
        return durable

    def _look(self, run_id: str, durable: dict[str, str], victim: str, told: str) -> None:
        daemon = self.daemon
        run = daemon.client.run(run_id)
        self.report.count(f"{run.state}")
        states, reasons = EXPLAINED[victim]
        if run.state not in states or run.reason not in reasons:
            self.report.blame("undefined", (told, run.state, run.reason, run.detail))
        self._look_at_disk(run_id, durable, told)
        time.sleep(0.3)
        if daemon.client.run(run_id).state != run.state:
            self.report.blame("undefined", (told, "it goes on by itself"))
        if run.state == "queued":
            daemon.resume()
            run = daemon.ended(run_id, END_BOUND_S)
        elif run.state != "succeeded":
            run = daemon.retry(run_id, END_BOUND_S)
        if run.state != "succeeded":
            self.report.blame("failed_retries", (told, run.state, run.reason, run.detail))
        elif wrong := self.wrong_steps(run_id):
            self.report.blame("false_successes", (told, wrong))
        self._look_at_disk(run_id, durable, f"{told}, retried")
        daemon.client.delete_run(run_id)

    def _look_at_disk(self, run_id: str, durable: dict[str, str], told: str) -> None:
        folder: Path = self.lab.root / run_id
        if lost := lost_frames(folder, durable):
            self.report.blame("lost_frames", (told, lost), len(lost))
        if wrong := complaints(folder):
            self.report.blame("undefined", (told, wrong))

    def wrong_steps(self, run_id: str) -> list[Any]:
        """Steps of a measurement that are not what the object has."""
        steps = self.daemon.client.result(run_id)["steps"]
        assert len(steps) == 4
        return [step for step in steps if abs(step["deviation_um"]) > SIGMAS * step["uncertainty_um"]]


def campaign(kills: int, seed: int, calibration: Path | None = None) -> Report:
    """Make a campaign of a size; `calibration` is where one is kept from one campaign to the next."""
    report = Report("kills", kills, seed)
    began_s = time.monotonic()
    with labs.lab() as lab:
        use_calibration(lab, calibration)
        here = Kills(lab, report, seed)
        try:
            for number in range(kills):
                try:
                    here.kill()
                except (TooLate, ClientError, AssertionError) as error:
                    report.blame("hangs", f"kill {number}: {error!r}; the log ends {tail(lab)}")
                    here.start()
        finally:
            here.close()
        if unrest := lab.unrest():
            report.blame("left_on", unrest)
    report.figures["duration_s"] = round(time.monotonic() - began_s, 1)
    return report


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--kills", type=int, default=50)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    return campaign(given.kills, given.seed).tell()


if __name__ == "__main__":
    sys.exit(main())
