"""At the camera's full rate nothing is lost because a process was not run for a moment."""

import os
import signal
import time
from pathlib import Path

import pytest

from drivers.values import CameraSettings

FULL_RATE_HZ = 90.0
# Its clock runs slower than ours, so that what a busy machine adds to a pause is few of its frames.
TIME_SCALE = 0.25
PATIENT_S = 20.0


@pytest.fixture
def streaming(other_rig):
    camera = other_rig(time_scale=TIME_SCALE).camera()
    camera.open()
    camera.configure(CameraSettings(exposure_us=1000.0, pixel_format="Mono8", frame_rate_hz=FULL_RATE_HZ))
    camera.arm()
    assert camera.fetch(PATIENT_S).index == 0
    yield camera
    camera.close()


def test_the_program_may_be_held_up(streaming) -> None:
    lost = streaming.counters().lost
    for _ in range(2):
        time.sleep(0.25 / TIME_SCALE)  # 22 frames
        first = streaming.fetch(PATIENT_S).index
        assert [streaming.fetch(PATIENT_S).index for _ in range(25)] == list(range(first + 1, first + 26))
    assert streaming.counters().lost == lost


def test_the_camera_s_process_may_be_held_up(streaming) -> None:
    lost = streaming.counters().lost
    for _ in range(2):
        os.kill(streaming.process_id, signal.SIGSTOP)
        time.sleep(0.09 / TIME_SCALE)  # 8 frames
        os.kill(streaming.process_id, signal.SIGCONT)
        first = streaming.fetch(PATIENT_S).index
        assert [streaming.fetch(PATIENT_S).index for _ in range(12)] == list(range(first + 1, first + 13))
    assert streaming.counters().lost == lost


def test_arming_again_takes_the_memory_of_before(streaming) -> None:
    def resident_kb() -> int:
        told = Path(f"/proc/{streaming.process_id}/smaps_rollup").read_text()
        return next(int(line.split()[1]) for line in told.splitlines() if line.startswith("Pss:"))

    streaming.stop()
    before_kb = resident_kb()
    for _ in range(10):
        streaming.arm(2)
        assert [frame.index for frame in streaming.frames(PATIENT_S)] == [0, 1]
    assert resident_kb() < before_kb + 1000
