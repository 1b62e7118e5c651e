"""All instruments of one world, wired to each other and served in one folder."""

import contextlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from sims.camera import CameraServer, CameraSettings, CameraTwin
from sims.clock import Clock
from sims.errors import SimulationError
from sims.process.physics import Physics, Places
from sims.projector.bitplanes import COLUMNS, ROWS
from sims.projector.lightcommander import LightCommander
from sims.projector.sequence_file import Sequence, batch_file
from sims.projector.usb_bus import UsbBus
from sims.stage import AxisSettings, Gcd0301m, Gcd040101m, Gsc, StageTwin
from sims.stage.twin import MakeFirmware

if TYPE_CHECKING:
    from sims.instruments import Stage1, Stage2
    from sims.world import World

CAMERA_SYNC = 1
"""The sync output of the projector that the camera's trigger input is wired to."""
COUNTS_PER_MM = 1000.0
HOME_MM = 0.0
"""Both axes have their origin sensor at their zero, where they also begin."""
EXPOSURES_US = (2500.0, 5000.0, 8000.0, 10_000.0, 12_000.0, 16_000.0, 20_000.0, 33_000.0, 50_000.0, 100_000.0)
SEQUENCE_LEDS = ("infrared", "green")
# A camera that reads out 2048 lines takes a frame every 11 072.5 us at most: patterns do not come faster.
SHORTEST_PERIOD_US = 11_100.0

Dialect = Literal["gsc", "gcd-0301m", "gcd-040101m"]
FIRMWARE: dict[Dialect, MakeFirmware] = {"gsc": Gsc, "gcd-0301m": Gcd0301m, "gcd-040101m": Gcd040101m}


@dataclass(frozen=True, slots=True)
class Conditions:
    """How a world is run: which dialect its stages speak, how fast its clock is, whether frames are replayed."""

    stages: Dialect = "gsc"
    time_scale: float = 1.0
    replay: bool = False


class Instruments:
    """Camera, projector and stages of a world; a context manager that serves them.

    Parameters
    ----------
    world : World
    folder : Path
        Where producer, sockets, serial ports and sequence files appear; must exist.
    conditions : Conditions

    Raises
    ------
    SimulationError
        The world's projector is not one that a LightCommander can be.
    """

    def __init__(self, world: "World", folder: Path, conditions: Conditions) -> None:
        if world.projector.size_px != (COLUMNS, ROWS):
            raise SimulationError(
                f"the simulated projector has {COLUMNS} x {ROWS} pixels, the world's projector.size_px is"
                f" {world.projector.size_px}: correct the world file"
            )
        self.world, self.folder, self.conditions = world, folder, conditions
        self.clock = Clock(conditions.time_scale)
        self.projector = LightCommander(self.clock)
        self.stages = {
            name: self._stage(name, settings)
            for name, settings in (("stage1", self._axis(world.stage1)), ("stage2", self._axis(world.stage2)))
        }
        self.physics = Physics(world, self.clock, self.projector.player, self._places, replay=conditions.replay)
        # A frame that had to wait for its rendering is not lost by the computer; at the sensor's true pace
        # it may be.
        lossless = not conditions.replay or conditions.time_scale > 1
        settings = CameraSettings(size_px=world.camera.size_px, lossless=lossless)
        self.camera = CameraTwin(self.physics.expose, self.clock, settings)
        self.camera_server = CameraServer(self.camera, folder)
        self.bus = UsbBus(folder / "usb.sock")
        self.sequences = tuple(self._sequence_files())
        self._ends = contextlib.ExitStack()

    def __enter__(self) -> Self:
        self._ends.callback(self.clock.close)
        try:
            self._start()
        except BaseException:
            self._ends.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.close()

    def _start(self) -> None:
        self._write_sequences()
        self.projector.on_sync(self._sync, CAMERA_SYNC)
        self._ends.callback(self.projector.close)
        self.bus.add(self.projector)
        self._start_one(self.bus.start, self.bus.close)
        for stage in self.stages.values():
            self._start_one(stage.start, stage.close)
        self._ends.callback(self.camera_server.cti.unlink, missing_ok=True)
        self._start_one(self.camera_server.start, self.camera_server.close)

    def _start_one(self, start: Callable[[], None], close: Callable[[], None]) -> None:
        self._ends.callback(close)
        start()

    def _sync(self, time_s: float) -> None:
        """Carry both edges of a sync pulse to the camera."""
        output = self.projector.player.output(CAMERA_SYNC)
        rising = output.rising
        self.camera.trigger(time_s, rising=rising)
        end_s = time_s + output.width_s
        self.clock.call_at(end_s, lambda: self.camera.trigger(end_s, rising=not rising))

    def _places(self, time_s: float) -> Places:
        return Places(*(self.stages[name].position_mm_at(time_s) for name in ("stage1", "stage2")))

    def _axis(self, stage: "Stage1 | Stage2") -> AxisSettings:
        low_mm, high_mm = stage.travel_mm if isinstance(stage.travel_mm, tuple) else (0.0, stage.travel_mm)
        return AxisSettings(
            counts_per_mm=COUNTS_PER_MM,
            travel_mm=(low_mm, high_mm),
            start_mm=HOME_MM,
            home_mm=HOME_MM,
            noise_um=stage.position_noise_um,
            backlash_um=stage.backlash_um,
        )

    def _stage(self, name: str, axis: AxisSettings) -> StageTwin:
        seed = np.random.SeedSequence([self.world.seed, *name.encode()]).generate_state(1)[0]
        firmware = FIRMWARE[self.conditions.stages]
        return StageTwin({1: axis}, firmware, self.clock, link=self.folder / name, seed=int(seed))

    def _write_sequences(self) -> None:
        folder = self.folder / "sequences"
        folder.mkdir(exist_ok=True)
        self._ends.callback(shutil.rmtree, folder, ignore_errors=True)
        for path, (led, exposure_us) in self._sequence_files().items():
            sequence = Sequence(exposure_us, max(exposure_us, SHORTEST_PERIOD_US), 8, (led,))
            path.write_text(batch_file(sequence))

    def _sequence_files(self) -> dict[Path, tuple[str, float]]:
        return {
            self.folder / "sequences" / f"{led}-{exposure_us:g}us.bf": (led, exposure_us)
            for led, exposure_us in product(SEQUENCE_LEDS, EXPOSURES_US)
        }
