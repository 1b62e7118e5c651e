"""Settings of the LightCommander's driver."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from drivers.projector.bitplanes import COLUMNS, ROWS
from drivers.projector.screen import ScreenSettings
from drivers.settings import Settings


class LightCommanderSettings(Settings):
    """How the box is reached, and the compiled sequences that may be used.

    Attributes
    ----------
    transport
        ``"usb"`` (with `profile`) or ``"ti_library"`` (with `library`).
    profile
        USB profile: the name of one that comes with the driver, or the path of a file (``.yaml``).
    library
        Path of the lab's own copy of TI's library.
    backend, backend_argument
        USB library as ``"module:function"`` and the argument that it is called with; none: libusb.
    serial_number
        USB serial number of the box; none: the first that is found.
    timeout_s
        Bound of one transfer, or of one call of the library.
    sequences
        Paths of compiled sequences (.bf): exposure, bits, rate and LEDs come from them.
    infrared_name
        How the heads of these files name the infrared LED. No published file lights it: unverified.
    video
        If given, patterns come by the video input, and USB or library only set LED and mode.
    """

    transport: Literal["usb", "ti_library"]
    profile: str | None = None
    library: str | None = None
    backend: str | None = None
    backend_argument: str | None = None
    serial_number: str | None = None
    timeout_s: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    sequences: tuple[str, ...] = ()
    infrared_name: str = "IRLED"
    video: ScreenSettings | None = None

    @model_validator(mode="after")
    def _complete(self) -> "LightCommanderSettings":
        if (self.transport == "usb") != (self.profile is not None):
            raise ValueError("the transport 'usb', and only that, needs a `profile`")
        if (self.transport == "ti_library") != (self.library is not None):
            raise ValueError("the transport 'ti_library', and only that, needs a `library`")
        if self.transport == "ti_library" and (self.backend or self.serial_number):
            raise ValueError("`backend` and `serial_number` belong to the transport 'usb'")
        if self.video is not None and self.video.size_px != (COLUMNS, ROWS):
            raise ValueError(f"the `size_px` of its video is ({COLUMNS}, {ROWS})")
        if (self.video is None) != bool(self.sequences):
            raise ValueError("give either `sequences` (patterns in the box's memory) or `video`")
        return self
