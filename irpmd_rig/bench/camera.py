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
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.protocols import Camera, CameraSettings, FramesLost
from drivers.registry import make
from irpmd_rig.bench.ticker import lateness_ms
from irpmd_rig.bench.timing import Row
from irpmd_rig.programs import module_command, module_environment

XIQ_FPS = 90.3
"""Frames a second of the real camera at full size: what a driver has to keep up with."""
FORMATS = ("Mono8", "Mono10", "Mono10p")
SEGMENTS = 3
WARM_UP_FRAMES = 20
FRAME_LIMIT_S = 10.0


@dataclass(slots=True)
class Taken:
    """What came of a stream, while it was counted."""

    seconds: float = 0.0
    frames: int = 0
    lost: int = 0

    def rows(self, name: str) -> list[Row]:
        """Its rate beside the real camera's, and what is missing from it."""
        fps = self.frames / self.seconds
        share = self.lost / max(1, self.frames + self.lost)
        return [
            Row(name, fps, "fps", "an xiQ", XIQ_FPS, fps / XIQ_FPS, "at least", None, None),
            Row(f"{name}: lost", self.lost, "frames", "frames fetched", self.frames, share, "at most", None, None),
        ]


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
        For each pixel format the rate of a camera that is as fast as frames are taken, then that of one that keeps
        the real camera's pace, each beside the real camera's rate and followed by the frames that were lost; and
        'other threads held up', the 99.9th percentile, whose ``ratio`` is the *difference* in ms to an idle process
        that ticks at the same time: once as fast as frames come (for information) and once at the real camera's
        pace (the goal's figure), each with the rate that was really kept meanwhile.

    Raises
    ------
    OSError
        The simulated camera cannot be run.
    InstrumentError
        The driver failed.
    """
    rows = []
    for pace, told, must, aim in (("unpaced", "as fast as they come", None, None), ("paced", "paced", 10.0, 2.0)):
        held_up = "other threads held up" if pace == "paced" else f"other threads held up, frames {told}"
        with twin_camera(size_px, pace) as camera:
            for name in FORMATS:
                rows += _rate(camera, name, seconds).rows(f"camera {name}, {told}")
            rows += _held_up(camera, held_up, seconds, must, aim)
    return rows


@contextmanager
def twin_camera(size_px: int, pace: str) -> Iterator[Camera]:
    """Open a simulated camera in a process of its own; pace: ``"paced"`` as a real one, or ``"unpaced"``."""
    with tempfile.TemporaryDirectory() as folder, _twin(Path(folder), size_px, pace) as producer:
        camera = make("camera", "harvesters", "camera", {"producer": producer})
        try:
            camera.open()
            yield camera
        finally:
            camera.close()


@contextmanager
def _twin(folder: Path, size_px: int, pace: str) -> Iterator[str]:
    # Run, not imported: the simulator is another program. It ends when its standard input does.
    command = module_command("sims", "camera", str(folder), "--size-px", str(size_px))
    command += ["--unpaced"] if pace == "unpaced" else []
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=module_environment()
    ) as process:
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


def _rate(camera: Camera, pixel_format: str, seconds: float) -> Taken:
    with _armed(camera, pixel_format):
        for _ in range(WARM_UP_FRAMES):
            _fetch(camera, Taken())
        with _counted(camera) as taken:
            end_s = time.perf_counter() + seconds
            while time.perf_counter() < end_s:
                _fetch(camera, taken)
    return taken


def _fetch(camera: Camera, taken: Taken) -> None:
    # At the camera's own pace a machine that is busy may lose some: the camera's counters tell how many.
    with suppress(FramesLost):
        camera.fetch(FRAME_LIMIT_S)
        taken.frames += 1


@contextmanager
def _counted(camera: Camera) -> Iterator[Taken]:
    taken = Taken()
    lost_before = camera.counters().lost
    start_s = time.perf_counter()
    yield taken
    taken.seconds = time.perf_counter() - start_s
    taken.lost = camera.counters().lost - lost_before


def _held_up(camera: Camera, name: str, seconds: float, must: float | None, aim: float | None) -> list[Row]:
    ours: list[float] = []
    idle: list[float] = []
    with streaming(camera) as taken:
        for _ in range(SEGMENTS):
            found = _side_by_side(seconds)
            ours += found[0]
            idle += found[1]
    late, control = (float(np.percentile(found, 99.9)) for found in (ours, idle))
    beside = "idle process alongside; ratio: ms beyond it"
    row = Row(name, late, "ms", beside, control, late - control, "at most", must, aim)
    return [row, *taken.rows(f"{name}: frames meanwhile")]


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
def _armed(camera: Camera, pixel_format: str) -> Iterator[None]:
    low_us = (camera.capabilities().exposure_range_us or (100.0, 0.0))[0]
    camera.configure(CameraSettings(exposure_us=low_us, pixel_format=pixel_format))
    camera.arm()
    try:
        yield
    finally:
        camera.stop()


@contextmanager
def streaming(camera: Camera) -> Iterator[Taken]:
    """Fetch frames in a thread of this process, and count them."""
    ends = threading.Event()

    def fetch() -> None:
        while not ends.is_set():
            _fetch(camera, taken)

    with _armed(camera, "Mono8"), _counted(camera) as taken:
        thread = threading.Thread(target=fetch, name="frames")
        thread.start()
        try:
            yield taken
        finally:
            ends.set()
            thread.join()
