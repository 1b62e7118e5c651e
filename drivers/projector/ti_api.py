"""Operations of TI's API for the LightCommander: their names, parameters and numbers, whatever carries them.

From the header of TI's portability layer as found in a public repository. The order of parameters is that of
the header; a transport decides how they get to the box.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.values import Led

Kind = Literal["byte", "uint16", "uint32", "double", "enum", "boolean", "string", "bytes", "uint16s"]
Value = int | float | str | bytes | tuple[int, ...]
Result = int | float | str | None

LED_NUMBERS = {Led.RED: 0, Led.GREEN: 1, Led.BLUE: 2, Led.INFRARED: 3}
SOURCE_DVI, SOURCE_SL_AUTO = 0, 3


@dataclass(frozen=True, slots=True)
class Operation:
    """One function of the API: (name, kind) of its parameters, and what it gives back."""

    parameters: tuple[tuple[str, Kind], ...] = ()
    result: Kind | None = None


_LED: tuple[str, Kind] = ("led", "enum")

OPERATIONS = {
    "DLP_Display_DisplayPatternManualForceFirstPattern": Operation(),
    "DLP_Display_DisplayPatternManualStep": Operation(),
    "DLP_Display_DisplayPatternAutoStepForSinglePass": Operation(),
    "DLP_Display_DisplayPatternAutoStepRepeatForMultiplePasses": Operation(),
    "DLP_Display_DisplayStop": Operation(),
    "DLP_Display_ParkDMD": Operation(),
    "DLP_Display_UnparkDMD": Operation(),
    "DLP_Img_DownloadBitplanePatternToExtMem": Operation(
        (("plane_bytes", "bytes"), ("byte_count", "uint32"), ("plane", "uint16"))
    ),
    "DLP_RegIO_WriteImageOrderLut": Operation((("bits_per_pixel", "byte"), ("order", "uint16s"), ("count", "uint16"))),
    "RunBatchFile": Operation((("file", "string"), ("stop_on_error", "boolean"))),
    "DLP_LED_SetLEDEnable": Operation((_LED, ("on", "byte"))),
    "DLP_LED_SetLEDintensity": Operation((_LED, ("percent", "double"))),
    "DLP_LED_LEDdriverEnable": Operation((("on", "byte"),)),
    "DLP_Sync_Configure": Operation(
        (("output", "byte"), ("polarity", "byte"), ("delay_us", "uint32"), ("width_us", "uint32"))
    ),
    "DLP_Sync_SetEnable": Operation((("output", "byte"), ("on", "byte"))),
    "DLP_Source_SetDataSource": Operation((("source", "enum"),)),
    "DLP_Status_CommunicationStatus": Operation(),
    "DLP_Status_GetDMDparkState": Operation(result="byte"),
    "DLP_Status_GetSeqRunState": Operation(result="byte"),
    "DLP_Status_GetSeqDataBPP": Operation(result="byte"),
    "DLP_Status_GetSeqDataExposure": Operation(result="double"),
    "DLP_Status_GetLEDdriverFault": Operation(result="byte"),
    "DLP_Status_GetOverallLEDdriverTempTimeoutState": Operation(result="byte"),
    "DLP_Status_GetMCUversionString": Operation(result="string"),
}


class Transport(Protocol):
    """A way to the box, used by one thread at a time."""

    def open(self) -> None:
        """Reach the box; NotConnected or ConfigurationError if that cannot be."""

    def close(self) -> None:
        """Let go of it; never raises, may be repeated."""

    @property
    def is_open(self) -> bool:
        """Whether it is reached, as far as is known."""

    def call(self, operation: str, **values: Value) -> Result:
        """Carry out one operation within the transport's bound.

        `RunBatchFile` takes the path of its file.
        """

    def recover(self) -> None:
        """Make the way usable again after an error; raises if that cannot be."""
