"""How long the service takes to answer while the rest of the daemon's process is busy.

`python -m irpmd_rig.bench.service URL REQUESTS` is the client: it reads the token from standard input, and prints what
each request took.
"""

from __future__ import annotations

import asyncio
import http.client
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.acquisition.rig_file import RigFile, Storage, read_rig
from irpmd_rig.bench.camera import streaming, twin_camera
from irpmd_rig.bench.measurement import SteppedMirror, calibrated, measured
from irpmd_rig.bench.timing import Row
from irpmd_rig.processing import Worker
from irpmd_rig.service.app import create_app
from irpmd_rig.service.notify import Notifier
from irpmd_rig.service.server import Server, listen
from irpmd_rig.service.settings import ServiceSettings
from irpmd_rig.service.token import read_token
from irpmd_rig.store import Store

NAME = "REST GET /rig while frames stream"
PATH = "/api/v1/rig"
# A person's browser or a monitor asks less often.
PAUSE_S = 0.01
START_LIMIT_S = 20.0
_THREADS = 2


def run(size_px: int = 2048, requests: int = 1000) -> list[Row]:
    """Measure what `GET /rig` takes, as another process sees it.

    Parameters
    ----------
    size_px
        Side of the square frames.
    requests
        How often it is asked, idle and busy each.

    Returns
    -------
    list of Row
        The 99th percentile and the median while a camera at its real pace delivers frames into the daemon's process
        and its computing process reconstructs one measurement after the other, each beside the same with nothing
        else going on; then the frames, and the reconstructions, that there were meanwhile.

    Raises
    ------
    SimulationError, OSError
        The simulated rig or camera cannot be run.
    """
    with tempfile.TemporaryDirectory(prefix="irpmd-service-") as folder, _served(Path(folder)) as (url, token):
        idle = _asked(url, token, requests)
        with (
            twin_camera(size_px, "paced") as camera,
            _computing(Path(folder) / "computed", size_px) as computed,
            streaming(camera) as taken,
        ):
            busy = _asked(url, token, requests)
    rows = []
    for told, share, must, aim in (("99th percentile", 99.0, 50.0, 20.0), ("median", 50.0, None, None)):
        value, baseline = (float(np.percentile(found, share)) for found in (busy, idle))
        beside = "nothing else going on"
        rows.append(Row(f"{NAME}, {told}", value, "ms", beside, baseline, baseline / value, "value at most", must, aim))
    done = len(computed)
    rows += taken.rows(f"{NAME}: frames meanwhile")
    rows.append(Row(f"{NAME}: reconstructions meanwhile", done, "", "one", 1, 1 / max(1, done), "at most", 1.0, None))
    return rows


@contextmanager
def _served(folder: Path) -> Iterator[tuple[str, str]]:
    """Serve a simulated rig from this process; gives address and token."""
    with RigDaemon(_rig_file(folder / "data"), threads=1) as daemon, listen("127.0.0.1", 0) as line:
        token = read_token(daemon.store.root)
        app = create_app(daemon, ServiceSettings(token))
        server = Server(app, line, Notifier({}), app.state.desk.close)
        thread = threading.Thread(target=asyncio.run, args=(server.serve(),), name="service")
        thread.start()
        try:
            end_s = time.monotonic() + START_LIMIT_S
            while not server.started and time.monotonic() < end_s:
                time.sleep(0.01)
            yield server.url, token
        finally:
            server.ask_to_end()
            thread.join()


def _rig_file(root: Path) -> RigFile:
    # Its own world is at rest, and so small that it takes nothing from what is measured.
    file = read_rig("sim").with_simulation(private=True, size_px=64)
    return replace(file, storage=Storage(root=root, reserve_gb=0.0))


@contextmanager
def _computing(root: Path, size_px: int) -> Iterator[list[float]]:
    """Reconstruct a measurement again and again in a computing process; gives when each was done."""
    store = Store(root)
    mirror = SteppedMirror(size_px, 8)
    calibrated(store, mirror)
    measurement = measured(store, mirror)
    worker = Worker(root, threads=_THREADS)
    ends = threading.Event()
    done: list[float] = []

    def compute() -> None:
        while not ends.is_set():
            worker.process(measurement.path)
            done.append(time.perf_counter())

    worker.process(measurement.path)
    thread = threading.Thread(target=compute, name="reconstructions")
    thread.start()
    try:
        yield done
    finally:
        ends.set()
        thread.join()
        worker.close()
        store.close()


def _asked(url: str, token: str, requests: int) -> list[float]:
    command = [sys.executable, "-m", "irpmd_rig.bench.service", url, str(requests)]
    found = subprocess.run(command, input=token, capture_output=True, text=True, check=True)
    times_ms: list[float] = json.loads(found.stdout)
    return times_ms


def ask(url: str, token: str, requests: int) -> list[float]:
    """Return what each of so many requests took, in ms, over one connection."""
    line = http.client.HTTPConnection(urlsplit(url).netloc, timeout=60)
    headers = {"Authorization": f"Bearer {token}"}
    took_ms = []
    for _ in range(requests):
        start_s = time.perf_counter()
        line.request("GET", PATH, headers=headers)
        answer = line.getresponse()
        content = answer.read()
        took_ms.append(1e3 * (time.perf_counter() - start_s))
        if answer.status != http.client.OK:
            raise OSError(f"{url}{PATH} answers {answer.status}: {content[:200]!r}")
        time.sleep(PAUSE_S)
    line.close()
    return took_ms


if __name__ == "__main__":
    sys.stdout.write(json.dumps(ask(sys.argv[1], sys.stdin.read().strip(), int(sys.argv[2]))))
