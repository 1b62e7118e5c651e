"""The one table of node names: what this driver looks for on a camera, tried from left to right.

Names without a mark are those of GenICam's Standard Features Naming Convention (SFNC). No description file of an
xiQ was at hand: marked rows (`unverified`) were never seen on one, and whoever uses them is told. The first
contact with a real camera should `dump` its nodes, so that this table can be corrected: here and nowhere else.
"""

from dataclasses import dataclass

Value = bool | int | float | str


@dataclass(frozen=True, slots=True)
class Choice:
    """A node that may serve a purpose.

    Attributes
    ----------
    value
        What it is set to, where the purpose is a switch.
    unit
        What one of the driver's units is in the node's.
    unverified
        What was never checked on an xiQ; empty where the naming convention says so.
    """

    name: str
    value: Value | None = None
    unit: float = 1.0
    unverified: str = ""


_TEMPERATURE = "DeviceTemperature as the node of the temperature of an xiQ"
_LINE = "LineSelector and LineMode as the nodes that make a line of an xiQ an input"
_TIMING = "AcquisitionTimingMode as the switch of the frame rate of an xiQ"

EXPOSURE_US = (Choice("ExposureTime"), Choice("ExposureTimeAbs"))
GAIN_DB = (Choice("Gain"),)
GAMMA = (Choice("Gamma", 1.0),)
# Written only where they exist: what would change the picture behind the driver's back.
AUTOMATICS_OFF = (
    Choice("AcquisitionMode", "Continuous"),
    Choice("ExposureMode", "Timed"),
    Choice("ExposureAuto", "Off"),
    Choice("GainAuto", "Off"),
    Choice("GammaEnable", False),
)
PIXEL_FORMAT = (Choice("PixelFormat"),)
WIDTH, HEIGHT = (Choice("Width"),), (Choice("Height"),)
COLUMN, ROW = (Choice("OffsetX"),), (Choice("OffsetY"),)
SENSOR_WIDTH, SENSOR_HEIGHT = (Choice("SensorWidth"), Choice("WidthMax")), (Choice("SensorHeight"), Choice("HeightMax"))
FRAME_RATE_HZ = (Choice("AcquisitionFrameRate"), Choice("AcquisitionFrameRateAbs"))
FRAME_RATE_ON = (
    Choice("AcquisitionFrameRateEnable", True),
    Choice("AcquisitionFrameRateMode", "Basic"),
    Choice("AcquisitionTimingMode", "FrameRate", unverified=_TIMING),
)
FRAME_RATE_OFF = (
    Choice("AcquisitionFrameRateEnable", False),
    Choice("AcquisitionFrameRateMode", "Off"),
    Choice("AcquisitionTimingMode", "FreeRun", unverified=_TIMING),
)
TRIGGER_SELECTOR = (Choice("TriggerSelector"),)
TRIGGER_KIND = "FrameStart"
TRIGGER_MODE = (Choice("TriggerMode"),)
TRIGGER_SOURCE = (Choice("TriggerSource"),)
TRIGGER_SOFTWARE = (Choice("TriggerSoftware"),)
TRIGGER_EDGE = (Choice("TriggerActivation"),)
SOFTWARE_SOURCES = ("Software",)
LINE_SOURCES = ("Line1", "Line0", "Line2")
LINE_INPUT = (
    Choice("LineSelector", unverified=_LINE),
    Choice("LineMode", "Input", unverified=_LINE),
)
READY_SELECTOR = (Choice("AcquisitionStatusSelector", "FrameTriggerWait"),)
READY = (Choice("AcquisitionStatus"),)
TEMPERATURE_C = (Choice("DeviceTemperature", unverified=_TEMPERATURE),)
VENDOR, MODEL = (Choice("DeviceVendorName"),), (Choice("DeviceModelName"),)
SERIAL_NUMBER = (Choice("DeviceSerialNumber"), Choice("DeviceID"))
# Any of these answers only where a camera does.
ALIVE = (Choice("Width"), Choice("PayloadSize"), Choice("DeviceModelName"))
STREAM_LOST = (Choice("StreamLostFrameCount"),)

UNVERIFIED_FORMATS = {
    name: f"{name} as the name of a 10 bit format of an xiQ" for name in ("Mono10", "Mono10p", "Mono10Packed")
}
