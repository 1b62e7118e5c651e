"""The one module that knows that a rig file may name a simulated world.

A world is a process (`python -m sims serve`) that serves a camera's producer, a USB bus and serial ports. What is
needed to reach them is filled into the rig file here; nothing else of the program can tell such a rig from a real
one, except that its operator answers by itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.registry import driver_class
from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.errors import SimulationError
from irpmd_rig.acquisition.rig_file import Checkerboard, Device, RigFile, Simulation, is_idle
from irpmd_rig.core import Drawing
from irpmd_rig.programs import module_command, module_environment

if TYPE_CHECKING:
    from irpmd_rig.recipes.plan import Scene

# The first start on a machine compiles the producer and the tracer's kernels.
START_LIMIT_S = 120.0
END_LIMIT_S = 6.0
OPERATOR = "simulated operator"
PRIVATE_PREFIX = "irpmd-world-"


def runtime_folder() -> Path:
    """Folder of this user's running worlds; made, for this user alone, if it is not there.

    Raises
    ------
    SimulationError
        It cannot be made, or belongs to somebody else.
    """
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "irpmd-rig" if runtime else Path(tempfile.gettempdir()) / f"irpmd-rig-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise SimulationError(
            f"the folder {folder} cannot be made: {error.strerror}", "set XDG_RUNTIME_DIR to a folder of yours"
        ) from None
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise SimulationError(
            f"the folder {folder} belongs to another user", "set XDG_RUNTIME_DIR to a folder of yours"
        )
    return folder


def default_folder(world: Path) -> Path:
    """Folder in which `irpmd-rig sim` serves a world, so that rigs find it there."""
    digest = hashlib.sha256(str(world.resolve()).encode()).hexdigest()[:12]
    return runtime_folder() / digest


def running_world(folder: Path | None = None) -> WorldControl:
    """Return the line to the world in a folder, or to the only one that `irpmd-rig sim` started.

    Raises
    ------
    SimulationError
        None answers, or several do and no folder is given.
    """
    if folder is not None:
        control = WorldControl(folder)
        control.hello()
        return control
    found = [control for path in sorted(runtime_folder().iterdir()) if (control := WorldControl(path)).answers()]
    if not found:
        raise SimulationError("no simulated world is running", "start one with irpmd-rig sim, or name its --folder")
    if len(found) > 1:
        listing = ", ".join(str(control.folder) for control in found)
        raise SimulationError(f"{len(found)} simulated worlds are running", f"name the --folder of one: {listing}")
    return found[0]


def serve_command(world: Path, folder: Path, options: Mapping[str, object], *, replay: bool = False) -> list[str]:
    """Command that serves a world in a folder; options by their names on its command line, None: not given."""
    command = module_command("sims", "serve", str(world), "--folder", str(folder))
    for name, value in options.items():
        command += [] if value is None else [f"--{name}", str(value)]
    return [*command, *(["--replay"] if replay else [])]


class SimulatedOperator:
    """Does in a simulated world what a person does at a real rig; `close` ends the world if it was started here.

    Parameters
    ----------
    control
        The line to the world's process.
    child
        The process, where it was started for this rig.

    Attributes
    ----------
    subjects
        What can be placed.
    board_poses
        Poses of the checkerboard.

    Raises
    ------
    SimulationError
        The world does not answer.
    """

    name = OPERATOR

    def __init__(self, control: WorldControl, child: _Child | None = None) -> None:
        self.control = control
        self._child = child
        hello = control.hello()
        self.subjects: tuple[str, ...] = tuple(hello["subjects"])
        self.board_poses: int = hello["board"]["poses"]

    def arrange(self, scene: Scene) -> None:
        """Place what a scene asks for: the thing to look at, the ground glass (turned as told), the lamp.

        Raises
        ------
        SimulationError
            The world has no such thing, or does not answer.
        """
        self.control.call("place", subject=scene.subject, pose=scene.pose)
        self.control.call("glass", present=scene.glass)
        if scene.turn_deg is not None:
            self.control.call("turn_glass", about_x_deg=scene.turn_deg[0], about_y_deg=scene.turn_deg[1])
        self.control.call("lamp", on=scene.lamp)

    def read_scale(self, stage: str) -> float:
        """Read the position of a stage, in mm, off the scale beside it, to a hundredth.

        Raises
        ------
        SimulationError
            There is no such stage, or the world does not answer.
        """
        stages = self.control.call("state")["stages"]
        if stage not in stages:
            raise SimulationError(f"the world has no {stage}", f"it has {', '.join(sorted(stages))}")
        return round(float(stages[stage]["position_mm"]), 2)

    def answers(self) -> bool:
        """Whether the world is there."""
        return self.control.answers()

    def close(self) -> None:
        """End the world, if it was started for this rig."""
        child, self._child = self._child, None
        if child is not None:
            child.end()


def attach(rig_file: RigFile) -> tuple[RigFile, SimulatedOperator]:
    """Find or start the world that a rig file names, and fill in how its instruments are reached.

    Parameters
    ----------
    rig_file
        One with a `world`. A running world of the same file is used if it fits `rig_file.simulation`; else one is
        started as a child, which ends when the operator is closed or this process is gone.

    Raises
    ------
    SimulationError
        The world does not start, or the folder that the rig file names holds none or another.
    """
    if rig_file.world is None:
        raise SimulationError(f"the rig {rig_file.name!r} has no simulated world", "use it as it is")
    child: _Child | None = None
    control = None if rig_file.simulation.private else _running(rig_file.world, rig_file.simulation)
    if control is None:
        child = _Child(rig_file.world, rig_file.simulation)
        control = child.control
    try:
        return _filled(rig_file, control.hello(), is_new=child is not None), SimulatedOperator(control, child)
    except BaseException:
        if child is not None:
            child.end()
        raise


def _running(world: Path, simulation: Simulation) -> WorldControl | None:
    """Return the line to a running world that fits, or None."""
    control = WorldControl(simulation.folder or default_folder(world))
    try:
        hello = control.hello()
    except SimulationError:
        if simulation.folder is None:
            return None
        raise SimulationError(
            f"no world answers in {simulation.folder}",
            f"start one: irpmd-rig sim {world} --folder {simulation.folder}, or leave out simulation.folder",
        ) from None
    differs = _differences(world, simulation, hello)
    if not differs:
        return control
    if simulation.folder is None:
        return None
    raise SimulationError(
        f"the world in {simulation.folder} is another one: {'; '.join(differs)}",
        "end it and start it as the rig file says, or correct the rig file",
    )


def _differences(world: Path, simulation: Simulation, hello: Mapping[str, Any]) -> list[str]:
    served = {**hello, "size_px": hello.get("camera_size_px", [None])[0]}
    wanted: dict[str, Any] = {
        "world": str(world.resolve()),
        "seed": simulation.seed,
        "size_px": simulation.size_px,
        "time_scale": simulation.time_scale,
        "replay": simulation.replay,
        "stages": simulation.stages,
    }
    return [
        f"{key} is {served.get(key)}, not {value}"
        for key, value in wanted.items()
        if value is not None and served.get(key) != value
    ]


def clear_stale_worlds() -> None:
    """Remove what worlds left whose programs were killed: nobody listens there, and none is about to."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PRIVATE_PREFIX}*"):
        with contextlib.suppress(OSError):
            told = folder.lstat()
            is_old = time.time() - told.st_mtime > START_LIMIT_S
            if told.st_uid == os.getuid() and is_old and WorldControl(folder).has_ended():
                shutil.rmtree(folder, ignore_errors=True)


class _Child:
    """A world that was started for one rig: it lives as long as the pipe to its standard input."""

    def __init__(self, world: Path, simulation: Simulation) -> None:
        clear_stale_worlds()
        self._folder = Path(tempfile.mkdtemp(prefix=PRIVATE_PREFIX))
        # Without a name: nothing of it stays, however this process ends.
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        self.control = WorldControl(self._folder)
        options = {
            "seed": simulation.seed,
            "size-px": simulation.size_px,
            "time-scale": simulation.time_scale,
            "stages": simulation.stages,
        }
        command = serve_command(world, self._folder, options, replay=bool(simulation.replay))
        command.append("--until-stdin-closes")
        # Its own session: Ctrl-C is for this process, which ends the world after the instruments.
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            start_new_session=True,
            env=module_environment(),
        )
        try:
            self._await_ready()
        except BaseException:
            self.end()
            raise

    def _await_ready(self) -> None:
        output = self._process.stdout
        assert output is not None
        end_s = time.monotonic() + START_LIMIT_S
        said = b""
        while b"\n" not in said:
            left_s = end_s - time.monotonic()
            if left_s <= 0 or not select.select([output], [], [], left_s)[0]:
                raise SimulationError(
                    f"the world was not ready within {START_LIMIT_S:g} s", "see that the machine is idle"
                )
            piece = os.read(output.fileno(), 4096)
            if not piece:
                raise SimulationError(
                    f"the world does not start: {self._last_words()}", "correct what it complains about"
                )
            said += piece

    def _last_words(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_LIMIT_S)
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("error: ") if lines else f"exit status {self._process.returncode}"

    def end(self) -> None:
        """End the process and remove its folder; never raises."""
        process = self._process
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        for call in (None, signal.SIGTERM, signal.SIGKILL):
            if call is not None:
                process.send_signal(call)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_LIMIT_S)
                break
        self._log.close()
        shutil.rmtree(self._folder, ignore_errors=True)


@dataclass(frozen=True, slots=True)
class _Known:
    """What a running world tells about its instruments."""

    hello: Mapping[str, Any]
    is_new: bool

    def of(self, device: Device) -> dict[str, Any]:
        """Settings of a device that the world knows and that its driver takes."""
        fields = driver_class(device.kind, device.driver, device=device.name).Settings.model_fields
        return {key: value for key, value in getattr(self, f"_{device.kind}")(device).items() if key in fields}

    def _camera(self, device: Device) -> dict[str, Any]:  # noqa: ARG002 - one camera
        return {"producer": self.hello["producer"]}

    def _projector(self, device: Device) -> dict[str, Any]:
        known = {
            "backend": self.hello["usb_backend"],
            "backend_argument": self.hello["usb_argument"],
            "sequences": tuple(self.hello["sequences"]),
        }
        return {key: value for key, value in known.items() if not is_idle(key, device.settings)}

    def _stage(self, device: Device) -> dict[str, Any]:
        axis = self.hello["axes"][device.name]
        return {
            "port": self.hello["ports"][device.name],
            "limits_mm": tuple(float(limit) for limit in self.hello[f"{device.name}_travel_mm"]),
            "counts_per_mm": float(axis["counts_per_mm"]),
            "home_position_mm": float(axis["home_position_mm"]),
            "sign": int(axis["sign"]),
            # Nothing has moved yet in a world that was just started.
            **({"moving_at_open_s": 0.0} if self.is_new else {}),
        }


def _filled(rig_file: RigFile, hello: Mapping[str, Any], *, is_new: bool) -> RigFile:
    known = _Known(hello, is_new)
    devices = {name: _filled_device(device, known) for name, device in rig_file.devices.items()}
    drawing, board = hello["drawing"], hello["board"]
    return replace(
        rig_file,
        devices=devices,
        drawing=rig_file.drawing
        or Drawing(**{key: (float(drawing[key][0]), float(drawing[key][1])) for key in drawing}),
        checkerboard=rig_file.checkerboard
        or Checkerboard(squares=tuple(board["squares"]), square_mm=float(board["square_mm"])),
    )


def _filled_device(device: Device, known: _Known) -> Device:
    # What the rig file says goes first.
    settings = {**known.of(device), **device.settings}
    scale = float(known.hello["time_scale"])
    if device.kind == "stage" and scale != 1.0:
        # The stage's clock runs faster, and so does its ringing die down.
        field = driver_class(device.kind, device.driver, device=device.name).Settings.model_fields.get("settle_s")
        if field is not None:
            settings["settle_s"] = settings.get("settle_s", field.default) / scale
    return replace(device, settings=settings)
