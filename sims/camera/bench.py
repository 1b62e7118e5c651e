"""How fast the simulated camera is: `python -m sims.camera.bench [--json] [--seconds S] [--size-px N]`.

Plain harvesters, in a process of its own, fetches frames from this process. Each frame is another picture
than the one before; complete buffers are counted, once as fetched and once with the pixels copied out.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sims.camera.device import CameraTwin
from sims.camera.parameters import CameraSettings
from sims.camera.pixels import Image
from sims.camera.server import CameraServer
from sims.clock import Clock

CASES = ("Mono8", "Mono10", "Mono10p")
PICTURES = 4
NODE_READS = 2000


def _pictures(size_px: int) -> dict[int, "itertools.cycle[Image]"]:
    chance = np.random.default_rng(1)
    shape = (size_px, size_px)
    return {
        8: itertools.cycle([chance.integers(0, 256, shape, np.uint8) for _ in range(PICTURES)]),
        10: itertools.cycle([chance.integers(0, 1024, shape, np.uint16) for _ in range(PICTURES)]),
    }


def measure(*, size_px: int, seconds: float, paced: bool) -> dict[str, float]:
    """Frames a second, and microseconds to read a node, as a GenTL client sees them.

    Parameters
    ----------
    size_px : int
        Width and height of the sensor.
    seconds : float
        How long each case runs.
    paced : bool
        Keep the sensor's times, or run as fast as possible.

    Returns
    -------
    dict
        Numbers by name; the names carry the units.
    """
    pictures = _pictures(size_px)
    settings = CameraSettings(size_px=(size_px, size_px), paced=paced)
    camera = CameraTwin(lambda _start_s, _exposure_us, bits: next(pictures[bits]), Clock(), settings)
    with tempfile.TemporaryDirectory() as folder, CameraServer(camera, Path(folder)) as server:
        command = [sys.executable, "-m", "sims.camera.bench"]
        command += ["--client", str(server.cti), "--seconds", str(seconds)]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True, timeout=60 + 20 * seconds)
    result: dict[str, float] = json.loads(done.stdout)
    return result


def _client(cti: str, seconds: float) -> dict[str, float]:
    from harvesters.core import Harvester

    result = {}
    harvester = Harvester()
    harvester.add_file(cti)
    harvester.update()
    acquirer = harvester.create(0)
    nodes = acquirer.remote_device.node_map
    nodes.ExposureTime.value = nodes.ExposureTime.min
    begin = time.perf_counter()
    for _ in range(NODE_READS):
        _ = nodes.Width.value
    result["node_read_us"] = (time.perf_counter() - begin) / NODE_READS * 1e6
    acquirer.num_buffers = 8
    for pixel_format in CASES:
        nodes.PixelFormat.value = pixel_format
        for copy in (False, True):
            name = f"{pixel_format.lower()}_{'copied_' if copy else ''}fps"
            result[name] = _rate(acquirer, seconds, copy=copy)
    acquirer.destroy()
    harvester.reset()
    return result


def _rate(acquirer, seconds: float, *, copy: bool) -> float:  # type: ignore[no-untyped-def]
    """Frames a second, from the eleventh frame on: the first ones touch fresh memory."""
    acquirer.start()
    kept = np.empty(acquirer.remote_device.node_map.PayloadSize.value, np.uint8)
    begin, frames = 0.0, -10
    while frames <= 0 or time.perf_counter() - begin < seconds:
        buffer = acquirer.fetch(timeout=5, is_raw=True)
        if copy:
            np.copyto(kept, np.frombuffer(buffer.raw_buffer, np.uint8, kept.size))
        buffer.parent.queue_buffer(buffer)
        frames += 1
        if frames == 0:
            begin = time.perf_counter()
    elapsed_s = time.perf_counter() - begin
    acquirer.stop()
    return frames / elapsed_s


def main() -> None:
    """Run the benchmark and print its numbers."""
    parser = argparse.ArgumentParser(prog="python -m sims.camera.bench", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--seconds", type=float, default=2.0, help="how long each case runs")
    parser.add_argument("--size-px", type=int, default=2048, help="width and height of the sensor")
    parser.add_argument("--client", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.client:
        sys.stdout.write(json.dumps(_client(chosen.client, chosen.seconds)))
        return
    result: dict[str, object] = {"size_px": chosen.size_px, "cores": os.cpu_count() or 1}
    result["unpaced"] = measure(size_px=chosen.size_px, seconds=chosen.seconds, paced=False)
    result["paced"] = measure(size_px=chosen.size_px, seconds=chosen.seconds, paced=True)
    if chosen.json:
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
        return
    for case in ("unpaced", "paced"):
        sys.stdout.write(f"{case}\n")
        for name, value in dict(result[case]).items():  # type: ignore[call-overload]
            sys.stdout.write(f"  {name:24s}{value:10.1f}\n")


if __name__ == "__main__":
    main()
