"""A daemon of one's own on a simulated rig: started as a user starts it, ended with whoever started it."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import threading
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from types import TracebackType
from typing import Any

from ruamel.yaml import YAML

from irpmd_rig.client import Client, ProblemError
from irpmd_rig.core.errors import MeasurementError
from irpmd_rig.programs import module_command, module_environment
from irpmd_rig.shipped import rig_file

# The first start on a machine compiles the camera's producer and the kernels of both sides.
START_LIMIT_S = 180.0
END_LIMIT_S = 40.0
RIG = "sim"


@dataclass(frozen=True, slots=True)
class SimulatedRig:
    """Which world, and how it is run.

    Attributes
    ----------
    world
        File of the world.
    seed, size_px
        Of its noise, and camera pixels along a side; None: as the world file says.
    time_scale
        How much faster than the real clock its clock runs.
    """

    world: Path
    seed: int | None
    size_px: int | None
    time_scale: float


class PrivateDaemon:
    """A daemon, and its client; a context manager.

    Parameters
    ----------
    rig
        What it serves.
    folder
        For its rig file, its runs and its log; it has to be there.

    Raises
    ------
    MeasurementError
        It does not start, or the rig cannot be used.
    """

    def __init__(self, rig: SimulatedRig, folder: Path) -> None:
        self._folder = folder
        self._log = folder / "daemon.log"
        (folder / "rig.yaml").write_text(_rig_file(rig, folder), encoding="utf-8")
        command = module_command("irpmd_rig", "serve", str(folder / "rig.yaml"), "--until-stdin-closes")
        with self._log.open("wb") as log:
            # A session of its own: Ctrl-C is for us, who then let it end in order.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                start_new_session=True,
                env=module_environment(),
            )
        self._client: Client | None = None

    def __enter__(self) -> Client:
        try:
            client = Client(self._ready(), self._folder / "data" / "token")
            self._client = client
            client.rig()
        except ProblemError as error:
            self.close()
            raise MeasurementError(str(error)) from error
        except BaseException:
            self.close()
            raise
        return client

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End it in order, so that the rig is safe; never raises, may be repeated."""
        if self._client is not None:
            self._client.close()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        try:
            self._process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ready(self) -> str:
        """Wait until it answers; returns its address."""
        output = self._process.stdout
        assert output is not None
        said: queue.Queue[str] = queue.Queue()
        threading.Thread(target=lambda: said.put(output.readline().decode()), daemon=True).start()
        try:
            line = said.get(timeout=START_LIMIT_S)
        except queue.Empty:
            raise MeasurementError(f"the daemon was not ready within {START_LIMIT_S:g} s") from None
        if not line.startswith("ready "):
            raise MeasurementError(f"the daemon does not start: {_wrong(line) or self._last_words()}")
        return line.removeprefix("ready ").strip()

    def _last_words(self) -> str:
        lines = self._log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        last = lines[-1] if lines else "it says nothing"
        with contextlib.suppress(ValueError, KeyError, TypeError):
            return str(json.loads(last)["event"])
        return last.removeprefix("error: ")


def _wrong(line: str) -> str:
    """What a daemon says that cannot start its rig: `broken URL what`."""
    return line.split(maxsplit=2)[2].strip() if line.startswith("broken ") else ""


def _rig_file(rig: SimulatedRig, folder: Path) -> str:
    """Write the shipped rig with another world and places of its own."""
    yaml = YAML()
    content: dict[str, Any] = yaml.load(rig_file(RIG).read_text(encoding="utf-8"))
    simulation = {"private": True, "time_scale": rig.time_scale, "seed": rig.seed, "size_px": rig.size_px}
    content["world"] = str(rig.world.resolve())
    content["simulation"] = {key: value for key, value in simulation.items() if value is not None}
    content["storage"] = {"root": str((folder / "data").resolve()), "reserve_gb": 0.1}
    content["service"] = {"port": 0}
    text = StringIO()
    yaml.dump(content, text)
    return text.getvalue()
