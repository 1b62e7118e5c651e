"""Simulated camera: an xiQ as a GenTL client sees it, in a process that is not the client's.

`CameraTwin` is the camera, `CameraServer` puts a GenTL producer for it into a folder and serves it.
"""

from sims.camera.acquisition import Counters, Picture, Render
from sims.camera.build import ProducerError, producer
from sims.camera.device import CameraTwin
from sims.camera.faults import CameraFaults
from sims.camera.parameters import CameraSettings
from sims.camera.server import CameraServer
from sims.camera.timing import SensorTiming

__all__ = [
    "CameraFaults",
    "CameraServer",
    "CameraSettings",
    "CameraTwin",
    "Counters",
    "Picture",
    "ProducerError",
    "Render",
    "SensorTiming",
    "producer",
]
