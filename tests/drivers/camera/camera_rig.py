"""A simulated camera and the driver on it."""

from pathlib import Path

import numpy as np

from drivers.camera.camera import HarvestersCamera
from drivers.camera.options import HarvestersSettings
from sims.camera import CameraServer, CameraTwin
from sims.camera import CameraSettings as TwinSettings
from sims.clock import Clock

WIDTH, HEIGHT = 64, 48


def picture(bits: int):
    image = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) * 7 % (1 << bits)
    return image.astype(np.uint8 if bits == 8 else np.uint16)


class Rig:
    """One simulated camera, served; and what a test needs of both ends."""

    def __init__(self, folder: Path, time_scale: float = 1.0, **twin: object) -> None:
        self.clock = Clock(time_scale)
        self.twin = CameraTwin(
            lambda _start_s, _exposure_us, bits: picture(bits),
            self.clock,
            TwinSettings(**{"size_px": (WIDTH, HEIGHT), **twin}),
        )
        self.server = CameraServer(self.twin, folder)
        self.server.start()

    @property
    def producer(self) -> str:
        return str(self.server.cti)

    def camera(self, **settings: object) -> HarvestersCamera:
        return HarvestersCamera("camera", HarvestersSettings(producer=self.producer, **settings))

    def close(self) -> None:
        self.server.close()
        self.clock.close()
