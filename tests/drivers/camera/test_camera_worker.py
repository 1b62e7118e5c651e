"""The worker process: replaced when it crashes, hangs or loses its camera; nothing of it stays."""

import gc
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import drivers
from drivers.errors import DeviceLost, InstrumentError, NotConnected, TimedOut
from drivers.values import CameraSettings, StopAnswer

SETTINGS = CameraSettings(exposure_us=100.0, pixel_format="Mono8", trigger="software")
# Every bound here is three seconds or less: it has ended by then on any machine, and what hangs has not.
ENDS_S = 30.0


def works(camera):
    camera.arm(1)
    camera.trigger()
    return camera.fetch(20).index == 0


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except FileNotFoundError:
        return False


def ends(pid: int) -> bool:
    deadline_s = time.monotonic() + ENDS_S
    while is_running(pid) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    return not is_running(pid)


def comes_back(camera):
    """Whether it works again, once the camera has noticed that its former client is gone."""
    deadline_s = time.monotonic() + ENDS_S
    while True:
        try:
            return camera.temperature_c() > 0
        except DeviceLost:
            if time.monotonic() > deadline_s:
                raise


@pytest.fixture
def working(rig):
    camera = rig.camera(answer_timeout_s=3.0)
    camera.open()
    camera.configure(SETTINGS)
    yield camera
    rig.twin.faults.answer_after(0)
    rig.twin.faults.replug()
    camera.close()


def test_it_is_a_session_of_its_own_and_ignores_a_terminals_interrupt(working):
    pid = working.process_id
    assert os.getsid(pid) == pid
    os.kill(pid, signal.SIGINT)
    assert works(working)
    assert working.process_id == pid


def test_a_crash_is_device_lost_and_the_next_operation_works(working):
    working.arm(1)
    pid = working.process_id
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(DeviceLost, match="process has ended"):
        working.fetch(5)
    assert works(working)
    assert working.process_id != pid


def test_a_hang_is_bounded_and_the_process_is_replaced(working):
    working.arm()
    pid = working.process_id
    os.kill(pid, signal.SIGSTOP)
    start_s = time.monotonic()
    with pytest.raises(TimedOut, match="given up"):
        working.fetch(0.1)
    assert time.monotonic() - start_s < ENDS_S
    assert works(working)
    assert not is_running(pid)


def test_a_worker_that_does_not_obey_stop_is_killed(working):
    working.arm()
    pid = working.process_id
    os.kill(pid, signal.SIGSTOP)
    start_s = time.monotonic()
    assert working.stop() == StopAnswer(stopped=True)
    assert time.monotonic() - start_s < ENDS_S
    assert not is_running(pid)
    assert works(working)


def test_a_worker_that_hangs_does_not_hold_up_close(working):
    pid = working.process_id
    os.kill(pid, signal.SIGSTOP)
    start_s = time.monotonic()
    working.close()
    assert time.monotonic() - start_s < ENDS_S
    assert not is_running(pid)


def test_unplugging_is_device_lost_and_after_replugging_it_works_with_the_same_settings(rig, working):
    working.configure(CameraSettings(exposure_us=321.0, pixel_format="Mono10", trigger="software"))
    working.arm(2)
    rig.twin.faults.unplug()
    start_s = time.monotonic()
    with pytest.raises(DeviceLost):
        working.fetch(0.2)
    assert time.monotonic() - start_s < ENDS_S
    with pytest.raises(DeviceLost, match="not come back"):
        working.arm(1)
    rig.twin.faults.replug()
    working.arm(1)
    working.trigger()
    frame = working.fetch(20)
    assert (frame.bits, frame.exposure_us) == (10, 321.0)


def test_unplugging_while_idle_is_told_by_the_next_operation(rig, working):
    rig.twin.faults.unplug()
    with pytest.raises(DeviceLost):
        working.temperature_c()
    rig.twin.faults.replug()
    assert working.temperature_c() > 0


def test_a_camera_that_is_not_plugged_in_is_not_connected(rig):
    rig.twin.faults.unplug()
    camera = rig.camera()
    with pytest.raises(NotConnected, match="no camera"):
        camera.open()
    assert camera.process_id is None
    rig.twin.faults.replug()
    camera.open()
    camera.close()


def test_a_camera_that_answers_too_late_is_bounded(rig, working):
    rig.twin.faults.answer_after(5.0)
    start_s = time.monotonic()
    with pytest.raises((TimedOut, DeviceLost)):
        working.temperature_c()
    assert time.monotonic() - start_s < ENDS_S
    rig.twin.faults.answer_after(0)
    assert comes_back(working)


def test_close_ends_an_operation_in_another_thread(working):
    working.arm()
    raised = []

    def wait():
        try:
            working.fetch(100)
        except InstrumentError as error:
            raised.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.1)
    working.close()
    thread.join(ENDS_S)
    assert raised


PARENT = """
import sys, time
from drivers.camera.camera import HarvestersCamera
from drivers.camera.options import HarvestersSettings
camera = HarvestersCamera("camera", HarvestersSettings(producer=sys.argv[1]))
camera.open()
camera.arm()
print(camera.process_id, flush=True)
time.sleep(60)
"""


def test_it_never_outlives_its_parent(rig):
    command = [sys.executable, "-c", PARENT, rig.producer]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        assert is_running(pid)
        parent.kill()
    assert ends(pid)


def resources():
    gc.collect()
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    rings = Path("/proc/self/maps").read_text().count("camera frames")
    shared = sum("camera" in path.name or "irpmd" in path.name for path in Path("/dev/shm").iterdir())
    semaphores = sum("GenICam" in path.name for path in Path("/dev/shm").iterdir())
    descriptors = sum(1 for _ in Path("/proc/self/fd").iterdir())
    threads = [thread.name for thread in threading.enumerate() if thread.name.startswith("camera camera")]
    return descriptors, threads, children, rings, shared, semaphores


def test_nothing_is_left(rig):
    camera = rig.camera(answer_timeout_s=2.0)

    def settled():
        # The twin's side of a connection ends a moment later than ours.
        deadline_s = time.monotonic() + ENDS_S
        while time.monotonic() < deadline_s and any(t.name == "camera client" for t in threading.enumerate()):
            time.sleep(0.01)
        return resources()

    def cycle(end):
        camera.open()
        camera.configure(SETTINGS)
        working = works(camera)
        camera.arm()
        end()
        camera.close()
        return working

    assert cycle(lambda: None)
    before = settled()
    assert cycle(camera.stop)
    assert cycle(lambda: os.kill(camera.process_id, signal.SIGKILL))
    camera.open()
    camera.configure(SETTINGS)
    camera.arm()
    rig.twin.faults.unplug()
    with pytest.raises(DeviceLost):
        camera.fetch(0.1)
    rig.twin.faults.replug()
    camera.close()
    rig.twin.faults.unplug()
    with pytest.raises(NotConnected):
        camera.open()
    rig.twin.faults.replug()
    assert settled() == before


def test_the_worker_is_of_the_same_copy_of_the_drivers(tmp_path):
    """A checkout that is not installed, beside another that is; whatever lies in the working folder."""
    copy, folder = tmp_path / "copy", tmp_path / "folder"
    package = Path(drivers.__file__).parent
    shutil.copytree(package, copy / "drivers", ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "drivers" / "camera" / "worker.py").write_text("raise SystemExit(7)")
    (folder / "drivers").mkdir(parents=True)
    (folder / "drivers" / "__init__.py").write_text("raise SystemExit(8)")
    code = (
        f"import sys; sys.path.insert(0, {str(copy)!r})\n"
        "from drivers.camera.link import Link\n"
        "link = Link('camera')\n"
        "link.end()\n"
        "print(link._process.returncode)\n"
    )
    result = subprocess.run([sys.executable, "-P", "-c", code], cwd=folder, capture_output=True, text=True, timeout=60)
    assert result.stdout.strip() == "7", result.stderr
