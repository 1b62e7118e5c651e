"""A world's process as its users see it: the command, the control line, and the real drivers."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, Self

from drivers.protocols import Camera, Projector, Stage
from drivers.registry import make

WORLD = Path(__file__).parents[3] / "configs" / "worlds" / "aligned.yaml"


class Refusal(Exception):
    """The world refused a call."""


def ask(folder: Path, call: str, **arguments: Any) -> dict[str, Any]:
    """Make one call over the control line."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(60)
        connection.connect(str(folder / "control.sock"))
        connection.sendall(json.dumps({"call": call, **arguments}).encode() + b"\n")
        with connection.makefile("rb") as reader:
            reply: dict[str, Any] = json.loads(reader.readline())
    if not reply.pop("ok"):
        raise Refusal(reply["error"])
    return reply


class ServedWorld:
    """`python -m sims serve` in a folder; a context manager that ends it."""

    def __init__(self, folder: Path, *options: str, world: Path = WORLD, start: bool = True) -> None:
        self.folder = folder
        command = [sys.executable, "-m", "sims", "serve", str(world), "--folder", str(folder), *options]
        command.append("--until-stdin-closes")
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        if start:
            self.await_ready()

    def await_ready(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == f"ready {self.folder.resolve()}\n", self.end()
        self.hello = self("hello")

    def __call__(self, call: str, **arguments: Any) -> dict[str, Any]:
        return ask(self.folder, call, **arguments)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> tuple[int, str]:
        """Close its standard input and wait; returns exit status and standard error."""
        _, errors = self.process.communicate(timeout=60)
        return self.process.returncode, errors

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, signal.SIGKILL)
        self.end()

    # ---- drivers, as a rig file would make them

    def camera(self, **settings: Any) -> Camera:
        return make("camera", "harvesters", "camera", {"producer": self.hello["producer"], **settings})

    def projector(self, **settings: Any) -> Projector:
        return make(
            "projector",
            "lightcommander",
            "projector",
            {
                "transport": "usb",
                "profile": "lightcommander-sim",
                "backend": self.hello["usb_backend"],
                "backend_argument": self.hello["usb_argument"],
                "sequences": tuple(self.hello["sequences"]),
                **settings,
            },
        )

    def stage(self, name: str, **settings: Any) -> Stage:
        axis = self.hello["axes"][name]
        return make(
            "stage",
            "serial",
            name,
            {
                "port": self.hello["ports"][name],
                "dialect": self.hello["stages"],
                "sign": axis["sign"],
                "limits_mm": tuple(self.hello[f"{name}_travel_mm"]),
                "counts_per_mm": axis["counts_per_mm"],
                "home_position_mm": axis["home_position_mm"],
                "speed_mm_per_s": 20.0,
                "settle_s": 0.2 / self.hello["time_scale"],
                **settings,
            },
        )
