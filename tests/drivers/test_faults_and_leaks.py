"""Whatever fails, and however often: errors are typed, ends are bounded, no success is false, and nothing is left."""

import gc
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from world_bench import WorldBench, raised

from drivers.errors import DeviceLost, InstrumentError, NotConnected

# The longest that any operation below may take, whatever happens meanwhile.
BOUND_S = 60.0
CAMPAIGN_S = 3.0
CYCLES = 3


def test_random_faults_end_in_typed_errors_and_no_success_is_false(bench: WorldBench) -> None:
    """Fourteen faults a second, of all kinds but those that no controller can know of."""
    names = [
        name
        for name in bench.world("fault_names")["names"]
        if name not in ("stage_lost_steps", "camera_cool", "projector_mend", "camera_recover")
        and not name.endswith("_replug")
    ]
    ends_s = time.monotonic() + CAMPAIGN_S
    done: dict[str, int] = {}
    wrong: list[BaseException] = []

    def use(name: str, operation: Callable[[], None]) -> None:
        while time.monotonic() < ends_s:
            began_s = time.monotonic()
            try:
                operation()
                done[name] = done.get(name, 0) + 1
            except InstrumentError as error:
                done[f"{name} fails"] = done.get(f"{name} fails", 0) + 1
                if error.device != name or not error.remedy:
                    wrong.append(error)
            except BaseException as error:
                wrong.append(error)
                return
            if time.monotonic() - began_s > BOUND_S:
                wrong.append(AssertionError(f"{name} took {time.monotonic() - began_s:.1f} s"))

    operations = {
        "camera": bench.shoot,
        "projector": lambda: bench.project(look=False),
        "stage1": lambda: bench.move("stage1"),
        "stage2": lambda: bench.move("stage2"),
    }
    bench.world("faults", seed=11, rate_per_s=0.7, names=names)
    users = [threading.Thread(target=use, args=item) for item in operations.items()]
    for user in users:
        user.start()
    for user in users:
        user.join()
    bench.world("faults", seed=None)
    assert wrong == []
    # Both happened: it was neither a campaign without faults nor one without operations.
    assert sum(times for what, times in done.items() if what.endswith("fails")) >= 5
    assert sum(done.get(name, 0) for name in operations) >= 5
    bench.mend()
    bench.works()


@dataclass(frozen=True)
class Left:
    """What there is of this process and of the world's."""

    children: int
    threads: int
    descriptors: int
    shared_memory: int
    segments: int
    of_world: tuple[int, int]


def count(world_pid: int) -> Left:
    gc.collect()
    tasks = Path("/proc/self/task").glob("*/children")
    world = Path(f"/proc/{world_pid}")
    return Left(
        children=sum(len(task.read_text().split()) for task in tasks),
        threads=threading.active_count(),
        descriptors=len(list(Path("/proc/self/fd").iterdir())),
        shared_memory=sum("memfd:" in line for line in Path("/proc/self/maps").read_text().splitlines()),
        segments=len(list(Path("/dev/shm").iterdir())),
        of_world=(len(list((world / "task").iterdir())), len(list((world / "fd").iterdir()))),
    )


def settled(world_pid: int, no_more_than: Left | None = None) -> Left:
    """Count, as soon as threads that are ending have ended."""
    give_up_s = time.monotonic() + 30.0
    while True:
        found = count(world_pid)
        time.sleep(0.1)
        if found == count(world_pid) and (no_more_than in (None, found) or time.monotonic() > give_up_s):
            return found


def strike(bench: WorldBench, cycle: int) -> None:
    """Break every instrument, each cycle in another way, and find it broken."""
    if cycle % 2:
        bench.fault("camera_unplug")
    else:
        os.kill(bench.camera.process_id, signal.SIGKILL)
    with raised("camera", DeviceLost):
        bench.camera.fetch(0.3)
    bench.fault("projector_unplug")
    with raised("projector", DeviceLost):
        bench.projector.set_led(*bench.light)
    for name, stage in bench.stages.items():
        bench.fault("stage_unplug", stage=name)
        with raised(name, DeviceLost):
            stage.position()


def test_nothing_is_left_of_instruments_that_failed(bench: WorldBench) -> None:
    pid = bench.world("hello")["pid"]
    bench.close()
    before = settled(pid)
    for cycle in range(CYCLES):
        bench.open()
        bench.works()
        bench.camera.arm()
        strike(bench, cycle)
        if cycle % 2:
            for instrument in (bench.projector, *bench.stages.values()):
                instrument.close()
                with pytest.raises(NotConnected):
                    instrument.open()
        bench.close()
        bench.mend()
        assert settled(pid, before) == before
    bench.open()
