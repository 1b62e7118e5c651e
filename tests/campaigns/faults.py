"""Short runs, each with a fault or two at a random moment: `python -m tests.campaigns.faults --runs 200 --seed 1`.

The daemon is one process for the whole campaign. After each run it is looked whether its state is explained by what
was done to it, whether a success is one (every frame there, whole, and the picture of its own pattern), whether
frames that were durable still are, whether the rig is at rest, and whether everything comes back by itself once the
fault is over.
"""

import argparse
import json
import random
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import psutil

from irpmd_rig.client import ClientError, ProblemError
from tests.campaigns import lab as labs
from tests.campaigns.lab import Daemon, Lab, TooLate, alive, until
from tests.campaigns.on_disk import complaints, durable_frames, lost_frames, pictures, shifted
from tests.campaigns.recipes import stations
from tests.campaigns.report import Report

# A run has ended so long after its fault, and the rig is ready so long after the end of the fault, at the latest.
END_BOUND_S = 45.0
READY_BOUND_S = 75.0
GONE = {"device_lost", "device_timeout", "device_fault"}
FRAMES = {"frames_lost", "frame_quality"}
# What the next move meets, whenever that comes; and what a run may leave for a later one although it succeeds.
OF_NEXT_MOVE = {"stage_stall", "stage_limit", "stage_overshoot", "stage_lost_steps"}
LASTING = {"camera_node_error", "trigger_missed", "sync_missed", "kill the computing process"} | OF_NEXT_MOVE
BOTH_STAGES = "  - {do: move, stage: stage2, position_mm: 4}\n  - {do: capture, label: mirror}\n"
PLACES_MM = (0.0, 8.0, 16.0, 24.0)


@dataclass(frozen=True)
class Kind:
    """A fault: its arguments by chance, and for which reasons a run may end of it."""

    reasons: set[str]
    draw: Any = field(default=lambda _: {})


def _some(name: str, most: int) -> Any:
    return lambda chance: {name: chance.randint(1, most)}


def _axis(**more: Any) -> Any:
    return lambda chance: (
        {"stage": chance.choice(["stage1", "stage2"])}
        | {name: chance.uniform(*bounds) for name, bounds in more.items()}
    )


OF_WORLD: dict[str, Kind] = {
    "frame_dropped": Kind(FRAMES, _some("frames", 8)),
    "frame_incomplete": Kind(FRAMES, lambda chance: {"frames": chance.randint(1, 3), "share": chance.uniform(0, 0.95)}),
    "frame_late": Kind(FRAMES, lambda chance: {"frames": chance.randint(1, 2), "seconds": chance.uniform(0.1, 20.0)}),
    "trigger_missed": Kind(FRAMES, _some("triggers", 3)),
    "sync_missed": Kind(FRAMES, _some("edges", 3)),
    "camera_unplug": Kind(GONE),
    "camera_hang": Kind(GONE | FRAMES),
    "camera_overheat": Kind(GONE),
    "camera_node_error": Kind(GONE | {"refused"}, lambda chance: {"access": chance.choice(["read", "write"])}),
    "camera_slow": Kind(GONE | FRAMES, lambda chance: {"seconds": chance.uniform(0.05, 1.0)}),
    "projector_unplug": Kind(GONE | FRAMES),
    "projector_stall": Kind(GONE, _some("transfers", 3)),
    "projector_timeout": Kind(GONE, _some("transfers", 3)),
    "projector_garbled": Kind(GONE | FRAMES, _some("replies", 3)),
    "projector_led_fault": Kind(GONE | FRAMES),
    "projector_overheat": Kind(GONE | FRAMES),
    "stage_unplug": Kind(GONE, _axis()),
    "stage_stall": Kind({"motion_failed"}, _axis()),
    "stage_limit": Kind({"limit", "motion_failed"}, _axis()),
    "stage_overshoot": Kind({"motion_failed"}, _axis(by_mm=(0.05, 2.0))),
    "stage_lost_steps": Kind({"motion_failed"}, _axis(counts=(50, 2000))),
    "stage_slow": Kind(GONE | {"motion_failed"}, _axis(seconds=(0.05, 1.0))),
    "stage_mute": Kind(GONE | {"motion_failed"}, _axis()),
    "stage_garbled": Kind(GONE | {"motion_failed"}, _axis()),
    "stage_endless": Kind(GONE | {"motion_failed"}, _axis()),
}
OF_PEOPLE = {
    "kill the camera's process": Kind(GONE),
    "kill the computing process": Kind({"reconstruction_failed"}),
    "stop": Kind({"stopped"}),
    "abort": Kind({"aborted_by_user"}),
}
KINDS = OF_WORLD | OF_PEOPLE


class Campaign:
    """A lab, its daemon, and the pictures of runs to which nothing happened."""

    def __init__(self, lab: Lab, daemon: Daemon, report: Report, seed: int) -> None:
        self.lab, self.daemon, self.report = lab, daemon, report
        self.chance = random.Random(seed)
        # Once for the caches, once for the time that it takes.
        for _ in range(2):
            run_id = daemon.submit(stations(*PLACES_MM, wait_s=0.1, more=BOTH_STAGES))
            daemon.resume()
            began_s = time.monotonic()
            run = daemon.ended(run_id)
            self.typical_s = time.monotonic() - began_s
            assert run.state == "succeeded", run.detail
        report.figures["typical_s"] = round(self.typical_s, 2)
        # Faults that no operation may have met yet.
        self.pending: set[str] = set()
        self.model = pictures(lab.root / run.id)

    def deck(self, runs: int) -> list[str]:
        """Faults in random order, every kind as often as every other."""
        names: list[str] = []
        while len(names) < runs:
            names += self.chance.sample(sorted(KINDS), len(KINDS))
        return names[:runs]

    def run(self, name: str) -> None:
        """One run with this fault, and sometimes another one."""
        chance = self.chance
        names = [name] if chance.random() < 0.75 else [name, chance.choice(sorted(KINDS))]
        recipe = stations(
            *PLACES_MM,
            more=BOTH_STAGES,
            trigger=chance.choice(["hardware", "software"]),
            retries=chance.choice([0, 1, 2]),
            wait_s=0.1,
        )
        run_id = self.daemon.submit(recipe)
        self.daemon.resume()
        durable: dict[str, str] = {}
        for fault in names:
            self._wait(run_id)
            durable |= durable_frames(self.lab.root / run_id)
            self._inject(fault, run_id)
        told = f"{run_id} {names}"
        if chance.random() < 0.3:
            # What does not last may be over before anything notices.
            time.sleep(chance.uniform(0.0, 1.0))
            self.lab.mend()
        met = self.daemon.client.run(run_id).state
        run = self.daemon.ended(run_id, END_BOUND_S)
        self.report.figures.setdefault("outcomes", {}).setdefault(name, []).append(f"{met}: {run.reason or run.state}")
        self.lab.mend()
        self._look(run, names, durable, told)
        self.daemon.client.clear_stop()
        self.daemon.ready(READY_BOUND_S)
        if unrest := self.lab.unrest():
            self.report.blame("left_on", (told, unrest))
        self._meet_the_rest()
        if run.state != "succeeded" and chance.random() < 0.5:
            self._retry(run_id, told)
        self.daemon.client.delete_run(run_id)

    def _wait(self, run_id: str) -> None:
        """Wait for a random moment of a run: how long it takes depends on what else the machine does."""
        frames = self.chance.choice([None, 0, 0, 6, 12, 18])

        def far_enough() -> bool:
            run = self.daemon.client.run(run_id)
            begun = run.state not in ("queued", "preparing") or frames is None
            return run.state in labs.FINAL or (begun and (run.frames or 0) >= (frames or 0))

        until(far_enough, END_BOUND_S, f"frame {frames} of run {run_id}")
        time.sleep(self.chance.uniform(0.0, 0.1 * self.typical_s))

    def _inject(self, fault: str, run_id: str) -> None:
        self.report.count("faults")
        self.pending.add(fault)
        client = self.daemon.client
        if fault in OF_WORLD:
            self.lab.fault(fault, **OF_WORLD[fault].draw(self.chance))
        elif fault == "stop":
            client.stop()
        elif fault == "abort":
            with self.daemon.lease():
                if client.run(run_id).state not in labs.FINAL:
                    try:
                        client.act(run_id, "abort")
                    except ClientError:
                        # It ended meanwhile.
                        assert client.run(run_id).state in labs.FINAL
        else:
            helper = self.daemon.helpers().get("camera" if "camera" in fault else "processing")
            if helper is not None:
                helper.kill()

    def _look(self, run: Any, names: list[str], durable: dict[str, str], told: str) -> None:
        folder = self.lab.root / run.id
        self.report.count(run.state)
        if lost := lost_frames(folder, durable):
            self.report.blame("lost_frames", (told, lost), len(lost))
        if wrong := complaints(folder):
            what = "false_successes" if run.state == "succeeded" else "undefined"
            self.report.blame(what, (told, wrong))
        elif run.state == "succeeded":
            if shift := shifted(folder, self.model):
                self._shifted(told, shift)
            # What came after its last frame is still to come.
            self.pending &= LASTING | set(names)
        elif run.reason not in set[str]().union(*(KINDS[name].reasons for name in self.pending)):
            self.report.blame("undefined", (told, run.state, run.reason, run.detail))

    def _shifted(self, told: str, shift: list[str]) -> None:
        if "stage_lost_steps" in self.pending:
            # A step counter cannot know of them.
            self.report.count("steps_lost_unseen")
        else:
            self.report.blame("false_successes", (told, shift))

    def _meet_the_rest(self) -> None:
        """Let the axes move by hand until no fault of a next move is left, and find their zeros again."""
        if not self.pending & OF_NEXT_MOVE:
            return
        client = self.daemon.client
        with self.daemon.lease():
            for stage in ("stage1", "stage2"):
                # It may have lost its zero: only homing is sure to be accepted.
                self._until_done(partial(client.stage_home, stage))
                self._until_done(partial(client.stage_move, stage, 2.0))
                self._until_done(partial(client.stage_home, stage))
                self._until_done(partial(client.stage_move, stage, 0.0))
        self.pending -= OF_NEXT_MOVE

    def _until_done(self, command: Any) -> None:
        for left in reversed(range(4)):
            try:
                command()
                return
            except ProblemError:
                if not left:
                    raise

    def _retry(self, run_id: str, told: str) -> None:
        self.report.count("retries")
        run = self.daemon.retry(run_id)
        if run.state != "succeeded" and not self.pending:
            self.report.blame("failed_retries", (told, run.reason, run.detail))
        self._look(run, [], {}, f"{told}, retried")


def campaign(runs: int, seed: int) -> Report:
    """Make a campaign of a size."""
    report = Report("faults", runs, seed)
    began_s = time.monotonic()
    with labs.lab() as lab:
        left: list[psutil.Process] = []
        done = 0
        names: list[str] = []
        while done < runs:
            with ExitStack() as stack:
                daemon = stack.enter_context(lab.daemon())
                here = Campaign(lab, daemon, report, seed + done)
                names = names or here.deck(runs)
                memory = daemon.memory_bytes()
                try:
                    while done < runs:
                        name = names[done]
                        done += 1
                        here.run(name)
                        if unfit := processes_too_many(daemon):
                            report.blame("left_on", unfit)
                    left = [psutil.Process(daemon.pid), *daemon.helpers().values()]
                    report.figures["memory_growth_mb"] = round((daemon.memory_bytes() - memory) / 1e6, 1)
                    daemon.terminate()
                except (TooLate, ClientError, AssertionError) as error:
                    report.blame("hangs", f"run {done} ({name}): {error!r}; the log ends {tail(lab)}")
                    lab.mend()
        if still := [process for process in left if alive(process)]:
            report.blame("left_on", still)
        if unrest := lab.unrest():
            report.blame("left_on", unrest)
    report.figures["duration_s"] = round(time.monotonic() - began_s, 1)
    return report


def processes_too_many(daemon: Daemon) -> list[str]:
    """Helpers of the daemon beyond one camera's and one computing process, and the world's own libraries."""
    children = psutil.Process(daemon.pid).children(recursive=True)
    modules = [word for child in children if alive(child) for word in child.cmdline() if word.startswith("irpmd_rig.")]
    return [f"{modules.count(name)} of {name}" for name in set(modules) if modules.count(name) > 1]


def tail(lab: Lab) -> str:
    """What the daemon said last of what went wrong."""
    events = []
    for line in lab.log.read_text().splitlines()[-200:]:
        try:
            told = json.loads(line)
        except ValueError:
            events.append(line)
            continue
        if told.get("level") != "info":
            events.append(f"{told.get('level')}: {told.get('event')}")
    return " | ".join(events[-6:])


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--runs", type=int, default=200)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    return campaign(given.runs, given.seed).tell()


if __name__ == "__main__":
    sys.exit(main())
