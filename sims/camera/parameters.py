"""What the camera is set to: values, their limits, what may be written when."""

from dataclasses import dataclass, field
from typing import Literal

from sims.camera.features import LINES, TRIGGERS, Feature, features
from sims.camera.nodemap import Value
from sims.camera.pixels import FORMATS, PixelFormat
from sims.camera.timing import SensorTiming
from sims.camera.wire import Refusal, Status

WIDTH_STEP_PX, HEIGHT_STEP_PX = 4, 2
"""Steps of the region (not an xiQ's: those are not known); 4 pixels fill whole bytes in every format."""
SMALLEST_PX = 16


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What a simulated camera is, and how it is served; fixed for its lifetime.

    `paced` cameras keep the sensor's times on their clock; others run as fast as the computer takes frames,
    without losing one. A paced one that is `lossless` waits for a computer that is too slow: where pictures take
    longer than the sensor's times, or the clock is fast, the computer is not to blame. `exposure_us` are the
    limits of the exposure (not an xiQ's: those are not known).
    """

    size_px: tuple[int, int] = (2048, 2048)
    model: str = "MQ042RG-CM"
    serial: str = "SIM00001"
    float_exposure: bool = True
    exposure_us: tuple[float, float] = (10.0, 1_000_000.0)
    line_padding_bytes: int = 0
    paced: bool = True
    lossless: bool = False
    timing: SensorTiming = field(default_factory=SensorTiming)


@dataclass(frozen=True, slots=True)
class FrameSettings:
    """What one frame is taken with."""

    pixel_format: PixelFormat
    offset_px: tuple[int, int]
    size_px: tuple[int, int]
    exposure_us: float
    gain_db: float
    gamma: float
    interval_s: float
    line_padding_bytes: int

    @property
    def payload_bytes(self) -> int:
        """Size of the frame in memory."""
        width, height = self.size_px
        return (self.pixel_format.line_bytes(width) + self.line_padding_bytes) * height


Limits = tuple[float, float, float]
Key = tuple[str, Value | None]


class Parameters:
    """Values of the features that a client can set, and those that follow from them.

    Parameters
    ----------
    settings : CameraSettings
        What the camera is.
    """

    def __init__(self, settings: CameraSettings):
        self._settings = settings
        self.features = {feature.name: feature for feature in features(float_exposure=settings.float_exposure)}
        self._values: dict[Key, Value] = {}
        self.reset()

    def reset(self) -> None:
        """Set all values as after power-up."""
        width, height = self._settings.size_px
        self._values = {
            ("DeviceVendorName", None): "XIMEA GmbH",
            ("DeviceModelName", None): self._settings.model,
            ("DeviceManufacturerInfo", None): "SIMULATED by irpmd-rig, not made by XIMEA",
            ("DeviceVersion", None): "simulated 1.0",
            ("DeviceSerialNumber", None): self._settings.serial,
            ("SensorWidth", None): width,
            ("SensorHeight", None): height,
            ("WidthMax", None): width,
            ("HeightMax", None): height,
            ("Width", None): width,
            ("Height", None): height,
            ("PixelFormat", None): FORMATS[0].value,
            ("AcquisitionFrameCount", None): 1,
            ("AcquisitionBurstFrameCount", None): 1,
            ("AcquisitionFrameRate", None): 30.0,
            ("ExposureTime", None): max(self._settings.exposure_us[0], 1000),
            ("Gamma", None): 1.0,
            ("LineMode", LINES[1][1]): 1,
        }

    def get(self, name: str) -> Value:
        """Value of a feature that is stored or follows from stored ones."""
        if name == "PayloadSize":
            return self.frame().payload_bytes
        value = self._values.get(self._key(name), 0)
        if name == "AcquisitionFrameRate":
            return min(float(value), self.limits(name)[1])
        return value

    def limits(self, name: str) -> Limits:
        """Minimum, maximum and increment of a feature that has them."""
        width, height = self._settings.size_px
        offset_x, offset_y = self._integer("OffsetX"), self._integer("OffsetY")
        match name:
            case "Width":
                return SMALLEST_PX, width - offset_x, WIDTH_STEP_PX
            case "Height":
                return SMALLEST_PX, height - offset_y, HEIGHT_STEP_PX
            case "OffsetX":
                return 0, width - self._integer("Width"), WIDTH_STEP_PX
            case "OffsetY":
                return 0, height - self._integer("Height"), HEIGHT_STEP_PX
            case "ExposureTime":
                return *self._settings.exposure_us, 1
            case "AcquisitionFrameRate":
                period_s = self._settings.timing.shortest_period_s(
                    float(self.get("ExposureTime")) * 1e-6, self._integer("Height")
                )
                return 0.1, 1 / period_s, 0
            case "Gain":
                return 0.0, 6.0, 0
            case "Gamma":
                return 0.1, 4.0, 0
            case "TLParamsLocked":
                return 0, 1, 1
            case _:
                return 1, 65535, 1

    def set(self, name: str, value: Value, *, acquiring: bool) -> None:
        """Set a feature.

        Raises
        ------
        Refusal
            If the value is out of range, or the feature cannot be set now.
        """
        feature = self.features[name]
        if feature.access == "RO":
            raise Refusal(Status.ACCESS_DENIED, f"{name} can only be read")
        if feature.locked and acquiring:
            raise Refusal(Status.ACCESS_DENIED, f"{name} cannot be set while frames are being acquired")
        self._check(feature, value)
        self._values[self._key(name)] = value

    def frame(self) -> FrameSettings:
        """Return what a frame is taken with now."""
        chosen = self._values["PixelFormat", None]
        free = self.get("AcquisitionFrameRateEnable") == 0
        return FrameSettings(
            pixel_format=next(known for known in FORMATS if known.value == chosen),
            offset_px=(self._integer("OffsetX"), self._integer("OffsetY")),
            size_px=(self._integer("Width"), self._integer("Height")),
            exposure_us=float(self.get("ExposureTime")),
            gain_db=float(self.get("Gain")),
            gamma=float(self.get("Gamma")),
            interval_s=0.0 if free else 1 / float(self.get("AcquisitionFrameRate")),
            line_padding_bytes=self._settings.line_padding_bytes,
        )

    def trigger(self) -> tuple[Literal["FrameStart", "FrameBurstStart"], int, int] | None:
        """Return the trigger that is on (what it starts, source, edge); None when free running."""
        for number, what in enumerate(("FrameStart", "FrameBurstStart")):
            if self._values.get(("TriggerMode", number)) == 1:
                source = self._values.get(("TriggerSource", number), 0)
                edge = self._values.get(("TriggerActivation", number), 0)
                return what, int(source), int(edge)  # type: ignore[return-value]
        return None

    def _integer(self, name: str) -> int:
        return int(self._values.get((name, None), 0))

    def _key(self, name: str) -> Key:
        selector = self.features[name].selector
        return name, self._values.get((selector, None), 0) if selector else None

    def _check(self, feature: Feature, value: Value) -> None:
        name = feature.name
        if feature.kind == "boolean" and value not in (0, 1):
            raise Refusal(Status.INVALID_VALUE, f"{name} is 0 or 1")
        if feature.entries and value not in {number for _, number in feature.entries}:
            raise Refusal(Status.INVALID_VALUE, f"{name} has no entry {value}")
        if feature.limited:
            low, high, step = self.limits(name)
            uneven = feature.kind == "integer" and (float(value) - low) % step != 0
            if uneven or not low <= float(value) <= high:
                raise Refusal(Status.INVALID_VALUE, f"{name}: {low} to {high}, steps of {step}, not {value}")
        if name == "LineMode" and value != self._values.get(self._key(name), 0):
            raise Refusal(Status.INVALID_VALUE, "a line's direction is fixed: Line1 in, Line2 out")
        if name == "TriggerMode" and value == 1:
            others = {number for _, number in TRIGGERS} - {self._key(name)[1]}
            if any(self._values.get((name, other)) == 1 for other in others):
                raise Refusal(Status.ACCESS_DENIED, "there is one trigger: switch the other selector's off first")
