"""A projector and a camera that looks at it, as twins on the wire, and the drivers on them."""

import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from drivers.registry import make
from irpmd_rig.acquisition.capture import CaptureSettings, Photographer
from sims.camera import CameraServer, CameraTwin
from sims.camera import CameraSettings as TwinSettings
from sims.clock import Clock
from sims.projector.lightcommander import LightCommander
from sims.projector.sequence_file import LEDS, Sequence, batch_file
from sims.projector.usb_bus import UsbBus
from sims.stage import Gsc, StageTwin
from sims.stage.motion import AxisSettings

WIDTH, HEIGHT = 256, 192
SPEED = 10.0
EXPOSURES_US = (2500.0, 5000.0, 12000.0, 20000.0)
# A frame takes milliseconds: only one that was lost is waited for that long, however busy the machine.
FRAME_TIMEOUT_S = 2.0


class Pair:
    """One world: what the projector shows is what the camera sees, and nothing else."""

    def __init__(self, folder: Path, exposures_us: tuple[float, ...] = EXPOSURES_US) -> None:
        self.clock = Clock(SPEED)
        self.bus = UsbBus(folder / "usb")
        self.bus.start()
        self.box = LightCommander(self.clock)
        self.bus.add(self.box)
        self.seen: Callable[[np.ndarray], np.ndarray] = lambda light: light
        self.brightness = 1.0
        self.ambient = 4.0
        self.twin = CameraTwin(
            self._note, self.clock, TwinSettings(size_px=(WIDTH, HEIGHT), exposure_us=(10.0, 200_000.0))
        )
        self.box.on_sync(self.twin.trigger, output=1)
        self.server = CameraServer(self.twin, folder)
        self.server.start()
        self.stage_twin = StageTwin(
            {1: AxisSettings(travel_mm=(-50.0, 50.0))}, Gsc, self.clock, link=folder / "stage1", seed=1
        )
        self.stage_twin.start()
        self.instruments = self._drivers(folder, exposures_us)
        for instrument in self._all():
            instrument.open()
        self.instruments.stages["stage1"].home()

    def _drivers(self, folder: Path, exposures_us: tuple[float, ...]) -> SimpleNamespace:
        files = []
        for exposure_us in exposures_us:
            files.append(folder / f"{exposure_us:g}.bf")
            files[-1].write_text(batch_file(Sequence(exposure_us, exposure_us, 8, LEDS)))
        projector = {
            "transport": "usb",
            "profile": "lightcommander-sim",
            "backend": "sims.projector.usb_backend:get_backend",
            "backend_argument": str(self.bus.socket_path),
            "sequences": tuple(map(str, files)),
        }
        stage = {
            "port": str(folder / "stage1"),
            "dialect": "gsc",
            "counts_per_mm": 1000.0,
            "sign": 1,
            "limits_mm": (-50.0, 50.0),
            "speed_mm_per_s": 20.0,
            "settle_s": 0.04,
            "in_position_mm": 0.02,
        }
        return SimpleNamespace(
            camera=make("camera", "harvesters", "camera", {"producer": str(self.server.cti)}),
            projector=make("projector", "lightcommander", "projector", projector),
            stages={"stage1": make("stage", "serial", "stage1", stage)},
        )

    def _all(self) -> tuple:
        return self.instruments.camera, self.instruments.projector, *self.instruments.stages.values()

    def photographer(self, trigger="hardware", cancelled=None, **settings: object) -> Photographer:
        given = CaptureSettings(**{"frame_timeout_s": FRAME_TIMEOUT_S, **settings})
        return Photographer(self.instruments, trigger, given, cancelled or threading.Event())

    def _note(self, start_s: float, exposure_us: float, bits: int):
        end_s = start_s + exposure_us / 1e6
        return lambda: self._picture(start_s, end_s, bits)

    def _picture(self, start_s: float, end_s: float, bits: int) -> np.ndarray:
        light = np.full((HEIGHT, WIDTH), self.ambient)
        for from_s, to_s, shown in self.box.intervals(start_s, end_s):
            if shown.image is not None:
                image = shown.image[2::4, 2::4].astype(float) + 2.0
                light += self.seen(image) * shown.level / 0.6 * (to_s - from_s) / 10e-3 * self.brightness
        noise = np.random.default_rng(int(start_s * 1e6)).normal(0.0, 0.7, light.shape)
        full = 2**bits - 1
        words = np.clip(np.rint((light + noise) * full / 255), 0, full)
        return words.astype(np.uint8 if bits == 8 else np.uint16)

    def close(self) -> None:
        for instrument in self._all():
            instrument.close()
        self.stage_twin.close()
        self.server.close()
        self.box.close()
        self.bus.close()
        self.clock.close()
