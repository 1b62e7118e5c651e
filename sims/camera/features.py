"""The camera's features: their names, kinds and fixed facts, modelled on GenICam's SFNC and on an xiQ.

No GenICam XML of an xiQ was found: names, units and limits here are the simulator's own.
"""

from dataclasses import dataclass
from typing import Literal

from sims.camera.pixels import FORMATS

Kind = Literal["integer", "float", "enumeration", "boolean", "command", "string"]
Access = Literal["RO", "RW", "WO"]

TEXT_BYTES = 64


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature of the node map.

    `limited` ones have a minimum, a maximum and (integers) an increment, which the device tells each time;
    `locked` ones cannot be written while frames are being acquired; `selector` names the feature that chooses
    which of several values this one stands for.
    """

    name: str
    kind: Kind
    category: str
    access: Access = "RW"
    entries: tuple[tuple[str, int], ...] = ()
    unit: str = ""
    limited: bool = False
    locked: bool = False
    selector: str = ""
    visibility: Literal["Beginner", "Expert", "Invisible"] = "Beginner"


def _entries(*names: str) -> tuple[tuple[str, int], ...]:
    return tuple((name, number) for number, name in enumerate(names))


TRIGGERS = _entries("FrameStart", "FrameBurstStart")
SOURCES = _entries("Software", "Line1")
LINES = _entries("Line1", "Line2")
MODES = _entries("Continuous", "SingleFrame", "MultiFrame")
COUNTERS = _entries("TransportTransferredFrames", "TransportSkippedFrames", "MissedTriggers")

_DEVICE = (
    Feature("DeviceVendorName", "string", "DeviceControl", "RO"),
    Feature("DeviceModelName", "string", "DeviceControl", "RO"),
    Feature("DeviceManufacturerInfo", "string", "DeviceControl", "RO"),
    Feature("DeviceVersion", "string", "DeviceControl", "RO"),
    Feature("DeviceSerialNumber", "string", "DeviceControl", "RO"),
    Feature("DeviceTemperature", "float", "DeviceControl", "RO", unit="C"),
    Feature("TimestampLatch", "command", "DeviceControl", "WO"),
    Feature("TimestampLatchValue", "integer", "DeviceControl", "RO", unit="ns"),
    Feature("TimestampReset", "command", "DeviceControl", "WO"),
)
_IMAGE = (
    Feature("SensorWidth", "integer", "ImageFormatControl", "RO"),
    Feature("SensorHeight", "integer", "ImageFormatControl", "RO"),
    Feature("WidthMax", "integer", "ImageFormatControl", "RO"),
    Feature("HeightMax", "integer", "ImageFormatControl", "RO"),
    Feature("Width", "integer", "ImageFormatControl", limited=True, locked=True),
    Feature("Height", "integer", "ImageFormatControl", limited=True, locked=True),
    Feature("OffsetX", "integer", "ImageFormatControl", limited=True, locked=True),
    Feature("OffsetY", "integer", "ImageFormatControl", limited=True, locked=True),
    Feature(
        "PixelFormat",
        "enumeration",
        "ImageFormatControl",
        entries=tuple((pixel_format.name, pixel_format.value) for pixel_format in FORMATS),
        locked=True,
    ),
)
_ACQUISITION = (
    Feature("AcquisitionMode", "enumeration", "AcquisitionControl", entries=MODES, locked=True),
    Feature("AcquisitionStart", "command", "AcquisitionControl", "WO"),
    Feature("AcquisitionStop", "command", "AcquisitionControl", "WO"),
    Feature("AcquisitionFrameCount", "integer", "AcquisitionControl", limited=True, locked=True),
    Feature("AcquisitionBurstFrameCount", "integer", "AcquisitionControl", limited=True, locked=True),
    Feature("AcquisitionFrameRateEnable", "boolean", "AcquisitionControl"),
    Feature("AcquisitionFrameRate", "float", "AcquisitionControl", unit="Hz", limited=True),
    Feature("TriggerSelector", "enumeration", "AcquisitionControl", entries=TRIGGERS),
    Feature(
        "TriggerMode",
        "enumeration",
        "AcquisitionControl",
        entries=_entries("Off", "On"),
        selector="TriggerSelector",
        locked=True,
    ),
    Feature(
        "TriggerSource",
        "enumeration",
        "AcquisitionControl",
        entries=SOURCES,
        selector="TriggerSelector",
        locked=True,
    ),
    Feature(
        "TriggerActivation",
        "enumeration",
        "AcquisitionControl",
        entries=_entries("RisingEdge", "FallingEdge"),
        selector="TriggerSelector",
    ),
    Feature("TriggerSoftware", "command", "AcquisitionControl", "WO", selector="TriggerSelector"),
)
_REST = (
    Feature("Gain", "float", "AnalogControl", unit="dB", limited=True),
    Feature("Gamma", "float", "AnalogControl", limited=True),
    Feature("LineSelector", "enumeration", "DigitalIOControl", entries=LINES),
    Feature(
        "LineMode",
        "enumeration",
        "DigitalIOControl",
        entries=_entries("Input", "Output"),
        selector="LineSelector",
    ),
    Feature("CounterSelector", "enumeration", "CounterAndTimerControl", entries=COUNTERS),
    Feature("CounterValue", "integer", "CounterAndTimerControl", "RO", selector="CounterSelector"),
    Feature("PayloadSize", "integer", "TransportLayerControl", "RO", unit="B", visibility="Expert"),
    Feature("TLParamsLocked", "integer", "TransportLayerControl", limited=True, visibility="Invisible"),
)


def features(*, float_exposure: bool) -> tuple[Feature, ...]:
    """All features; ExposureTime as Float or, as an xiQ may have it, as Integer."""
    kind: Kind = "float" if float_exposure else "integer"
    exposure = Feature("ExposureTime", kind, "AcquisitionControl", unit="us", limited=True)
    return (*_DEVICE, *_IMAGE, *_ACQUISITION, exposure, *_REST)
