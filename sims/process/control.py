"""The line by which people's hands and tests' eyes reach a running world.

A request is a JSON object on one line, ``{"call": "place", "subject": "plate"}``; the reply is one, too: ``ok`` true
with what was asked for, or ``ok`` false with an ``error``. The calls:

- ``hello``: the world, how its instruments are reached, and what a lab would know about them.
- ``place`` (subject, pose), ``glass`` (present), ``turn_glass`` (about_x_deg, about_y_deg: from where it is), ``lamp``
  (on): what people do by hand.
- ``state``: what the hardware is doing, truly.
- ``fault`` (name and its arguments), ``fault_names``, ``injected``: faults, and the record of them.
- ``faults`` (seed, rate_per_s, names): switch random faults on; without a seed, switch whatever script runs off.
- ``stop``: end the world.
"""

import json
import logging
import os
import socketserver
import threading
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, ValidationError, validate_call

from sims.errors import SimulationError, WorldError
from sims.process.complaints import complaint, one_of
from sims.process.faults import Faults
from sims.process.instruments import COUNTS_PER_MM, HOME_MM, Instruments
from sims.process.script import RandomFaults, Script
from sims.projector.bitplanes import COLUMNS, ROWS
from sims.surfaces import SUBJECTS

_log = logging.getLogger(__name__)

SOCKET = "control.sock"
USB_BACKEND = "sims.projector.usb_backend:get_backend"
LONGEST_REQUEST_BYTES = 64_000
# Types are as written: "yes" is no truth value, 1.5 no number of a pose.
_strict = validate_call(config=ConfigDict(strict=True))

Answer = dict[str, Any]


class Control:
    """Answers the calls; each is a method of its own name.

    Parameters
    ----------
    instruments : Instruments
    world_file : Path
        What the world was read from.
    faults : Faults
    script : Script
        What injects faults by itself.
    stop : callable
        Ends the world.
    """

    def __init__(
        self, instruments: Instruments, world_file: Path, faults: Faults, script: Script, stop: Callable[[], None]
    ) -> None:
        self._instruments, self._faults, self._script = instruments, faults, script
        self._world_file = world_file.resolve()
        self._stop = stop
        self._calls: dict[str, Callable[..., Answer]] = {
            # Its arguments are the fault's, which checks them.
            "fault": self._fault,
        } | {
            name: _strict(call)
            for name, call in (
                ("hello", self._hello),
                ("place", self._place),
                ("glass", self._glass),
                ("turn_glass", self._turn_glass),
                ("lamp", self._lamp),
                ("state", self._state),
                ("faults", self._switch_script),
                ("fault_names", lambda: {"names": faults.names}),
                ("injected", lambda: {"injected": [asdict(entry) for entry in faults.injected]}),
                ("stop", self._end),
            )
        }

    def answer(self, line: bytes) -> Answer:
        """Answer one request; a wrong one by `ok` false and what is wrong with it."""
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or not isinstance(request.get("call"), str):
                raise SimulationError('a request is an object such as {"call": "state"}')
            name = request.pop("call")
            if name not in self._calls:
                raise SimulationError(f"there is no call {name!r}{one_of(name, self._calls)}")
            return {"ok": True, **self._calls[name](**request)}
        except ValidationError as error:
            return {"ok": False, "error": complaint(error)}
        except (SimulationError, WorldError, ValueError, RecursionError) as error:
            return {"ok": False, "error": str(error)}

    def _hello(self) -> Answer:
        instruments, world = self._instruments, self._instruments.world
        camera, glass, board = world.camera, world.glass, world.board
        axis = {"counts_per_mm": COUNTS_PER_MM, "home_position_mm": HOME_MM, "sign": 1}
        return {
            "world": str(self._world_file),
            "name": self._world_file.stem,
            "pid": os.getpid(),
            "seed": world.seed,
            "camera_size_px": camera.size_px,
            "time_scale": instruments.conditions.time_scale,
            "replay": instruments.conditions.replay,
            "stages": instruments.conditions.stages,
            "producer": str(instruments.camera_server.cti),
            "usb_backend": USB_BACKEND,
            "usb_argument": str(instruments.bus.socket_path),
            "ports": {name: stage.url for name, stage in instruments.stages.items()},
            "sequences": [str(path) for path in instruments.sequences],
            "projector_size_px": (COLUMNS, ROWS),
            "stage1_travel_mm": world.stage1.travel_mm,
            "stage2_travel_mm": (0.0, world.stage2.travel_mm),
            "axes": dict.fromkeys(instruments.stages, axis),
            "drawing": {
                "camera_xy_mm": camera.position_mm[:2],
                "heading": camera.axis[:2],
                "d_point_mm": glass.centre_mm[:2],
            },
            "board": {"squares": board.squares, "square_mm": board.square_mm, "poses": board.poses},
            "objects": list(world.objects),
            "subjects": [*SUBJECTS, *world.objects],
        }

    def _place(self, subject: str, pose: int = 0) -> Answer:
        self._instruments.physics.place(subject, pose)
        return {}

    def _glass(self, present: bool) -> Answer:
        self._instruments.physics.set_glass(present)
        return {}

    def _turn_glass(self, about_x_deg: float, about_y_deg: float) -> Answer:
        self._instruments.physics.turn_glass(about_x_deg, about_y_deg)
        return {}

    def _lamp(self, on: bool) -> Answer:
        self._instruments.physics.set_lamp(on)
        return {}

    def _state(self) -> Answer:
        instruments = self._instruments
        now_s = instruments.clock.now()
        player, subject = instruments.projector.player, instruments.physics.subject
        shown = player.shown_at(now_s)
        lights = player.lights_at(now_s)
        return {
            "time_s": now_s,
            "led": "+".join(lights) or None,
            "intensity": max(lights.values(), default=0.0),
            "showing": player.index_at(now_s),
            "light": shown.level > 0,
            "running": player.running(now_s),
            "parked": instruments.projector.parked,
            "stages": {
                name: {"position_mm": stage.position_mm(), "moving": stage.moving(), "plugged": stage.plugged}
                for name, stage in instruments.stages.items()
            },
            "camera": {
                "armed": instruments.camera.acquiring,
                "plugged": instruments.camera.plugged,
                "counters": asdict(instruments.camera.counters),
            },
            "subject": subject.name,
            "pose": subject.pose,
            "glass": subject.glass,
            "glass_turn_deg": subject.glass_turn_deg,
            "lamp": subject.lamp,
        }

    def _fault(self, name: Any = None, **arguments: Any) -> Answer:
        self._faults.inject(str(name), arguments)
        return {}

    def _switch_script(
        self, seed: int | None = None, rate_per_s: float = 0.2, names: list[str] | None = None
    ) -> Answer:
        self._script.stop()
        if seed is not None:
            self._script.start_random(RandomFaults(seed=seed, rate_per_s=rate_per_s, names=names and tuple(names)))
        return {}

    def _end(self) -> Answer:
        self._stop()
        return {}


class ControlServer(socketserver.ThreadingUnixStreamServer):
    """Serves a `Control` in a folder; clients may come and go, many at a time.

    Parameters
    ----------
    control : Control
    folder : Path
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, control: Control, folder: Path) -> None:
        self.control = control
        self.path = folder / SOCKET
        self.path.unlink(missing_ok=True)
        super().__init__(str(self.path), _Client)
        self._thread = threading.Thread(target=self.serve_forever, args=(0.05,), name="control", daemon=True)

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self.path.unlink(missing_ok=True)
        self.shutdown()
        self._thread.join()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """Take note of a client that went away in mid-sentence."""
        _log.info("a client of the control line went away", exc_info=True)


class _Client(socketserver.StreamRequestHandler):
    server: ControlServer

    def handle(self) -> None:
        while line := self.rfile.readline(LONGEST_REQUEST_BYTES + 1):
            if not line.endswith(b"\n"):
                answer: Answer = {
                    "ok": False,
                    "error": f"a request is one line of at most {LONGEST_REQUEST_BYTES} bytes",
                }
            else:
                answer = self.server.control.answer(line)
            self.wfile.write(json.dumps(answer).encode() + b"\n")
            if not line.endswith(b"\n"):
                return
