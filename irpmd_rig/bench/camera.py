"""Speed of the camera driver against the simulated camera, and how much it holds up the program's other threads."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from drivers.protocols import Camera, CameraSettings, FramesLost
from drivers.registry import make
from irpmd_rig.bench.ticker import lateness_ms
from irpmd_rig.bench.timing import Row

XIQ_FPS = 90.3
"""Frames a second of the real camera at full size: what a driver has to keep up with."""
FORMATS = ("Mono8", "Mono10", "Mono10p")
SEGMENTS = 3
WARM_UP_FRAMES = 20
FRAME_LIMIT_S = 10.0
# Run, not imported: the simulator is another program. It ends when its standard input does.
_TWIN = """
import itertools, sys
from pathlib import Path
import numpy as np
from sims.camera import CameraServer, CameraSettings, CameraTwin
from sims.clock import Clock
chance = np.random.default_rng(1)
size, paced = int(sys.argv[2]), sys.argv[3] == "paced"
kinds = {8: np.uint8, 10: np.uint16}
pictures = {
    bits: itertools.cycle([chance.integers(0, 1 << bits, (size, size), kind) for _ in range(4)])
    for bits, kind in kinds.items()
}
settings = CameraSettings(size_px=(size, size), paced=paced)
twin = CameraTwin(lambda start_s, exposure_us, bits: next(pictures[bits]), Clock(), settings)
with CameraServer(twin, Path(sys.argv[1])) as server:
    print(server.cti, flush=True)
    sys.stdin.read()
"""


def run(size_px: int = 2048, seconds: float = 3.0) -> list[Row]:
    """Measure frames a second through the driver, and the lateness of another thread meanwhile.

    Parameters
    ----------
    size_px
        Side of the square frames.
    seconds
        How long each measurement lasts.

    Returns
    -------
    list of Row
        One for each pixel format, with the real camera's rate as baseline; and 'other threads held up', the 99.9th
        percentile, whose ``ratio`` is the *difference* in ms to an idle process that ticks at the same time: once
        at the real camera's pace (the goal's figure) and once as fast as frames come (for information).

    Raises
    ------
    OSError
        The simulated camera cannot be run.
    InstrumentError
        The driver failed.
    """
    rows = []
    with _camera(size_px, "unpaced") as camera:
        for name in FORMATS:
            fps = _frames_a_second(camera, name, seconds)
            rows.append(Row(f"camera {name}", fps, "fps", "an xiQ", XIQ_FPS, fps / XIQ_FPS, "at least", None, None))
        rows.append(_held_up(camera, "other threads held up, frames as fast as they come", seconds, None, None))
    with _camera(size_px, "paced") as camera:
        rows.append(_held_up(camera, "other threads held up", seconds, 10.0, 2.0))
    return rows


@contextmanager
def _camera(size_px: int, pace: str) -> Iterator[Camera]:
    with tempfile.TemporaryDirectory() as folder, _twin(Path(folder), size_px, pace) as producer:
        camera = make("camera", "harvesters", "camera", {"producer": producer})
        try:
            camera.open()
            yield camera
        finally:
            camera.close()


@contextmanager
def _twin(folder: Path, size_px: int, pace: str) -> Iterator[str]:
    command = [sys.executable, "-c", _TWIN, str(folder), str(size_px), pace]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin
        assert process.stdout
        try:
            producer = process.stdout.readline().strip()
            if not producer:
                raise OSError("the simulated camera did not start")
            yield producer
        finally:
            process.stdin.close()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def _frames_a_second(camera: Camera, pixel_format: str, seconds: float) -> float:
    low_us = (camera.capabilities().exposure_range_us or (100.0, 0.0))[0]
    camera.configure(CameraSettings(exposure_us=low_us, pixel_format=pixel_format))
    camera.arm()
    for _ in range(WARM_UP_FRAMES):
        camera.fetch(FRAME_LIMIT_S)
    start_s, frames = time.perf_counter(), 0
    while time.perf_counter() - start_s < seconds:
        camera.fetch(FRAME_LIMIT_S)
        frames += 1
    elapsed_s = time.perf_counter() - start_s
    camera.stop()
    return frames / elapsed_s


def _held_up(camera: Camera, name: str, seconds: float, must: float | None, aim: float | None) -> Row:
    ours: list[float] = []
    idle: list[float] = []
    with _streaming(camera):
        for _ in range(SEGMENTS):
            found = _side_by_side(seconds)
            ours += found[0]
            idle += found[1]
    late, control = (float(np.percentile(found, 99.9)) for found in (ours, idle))
    return Row(
        name, late, "ms", "idle process alongside; ratio: ms beyond it", control, late - control, "at most", must, aim
    )


def _side_by_side(seconds: float) -> tuple[list[float], list[float]]:
    """Lateness of a thread of this process, and of a process that does nothing else, at the same time."""
    command = [sys.executable, "-m", "irpmd_rig.bench.ticker", str(seconds)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin
        assert process.stdout
        process.stdout.readline()
        process.stdin.write("\n")
        process.stdin.flush()
        late = lateness_ms(seconds)
        # Read before it is parsed: thousands of numbers are more than a pipe holds.
        return late, json.loads(process.stdout.read())


@contextmanager
def _streaming(camera: Camera) -> Iterator[None]:
    low_us = (camera.capabilities().exposure_range_us or (100.0, 0.0))[0]
    camera.configure(CameraSettings(exposure_us=low_us, pixel_format="Mono8"))
    camera.arm()
    ends = threading.Event()

    def fetch() -> None:
        while not ends.is_set():
            # At the camera's own pace a machine that is busy may lose some.
            with suppress(FramesLost):
                camera.fetch(FRAME_LIMIT_S)

    thread = threading.Thread(target=fetch, name="frames")
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()
        camera.stop()
