"""Simulated stage controllers: firmware written by hand from the tables, on serial lines or sockets."""

from sims.stage.firmware_gcd0301m import Gcd0301m
from sims.stage.firmware_gcd040101m import Gcd040101m
from sims.stage.firmware_gsc import Gsc
from sims.stage.line import Firmware, LineFaults, LineSettings
from sims.stage.motion import Axis, AxisSettings, Speed
from sims.stage.port import SerialPort, SocketPort
from sims.stage.twin import StageFaults, StageTwin

__all__ = [
    "Axis",
    "AxisSettings",
    "Firmware",
    "Gcd0301m",
    "Gcd040101m",
    "Gsc",
    "LineFaults",
    "LineSettings",
    "SerialPort",
    "SocketPort",
    "Speed",
    "StageFaults",
    "StageTwin",
]
