"""Settings of the camera drivers in a rig file."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.settings import Settings


class CameraOptions(Settings):
    """What every camera over GenICam is set to, whatever reaches it.

    Attributes
    ----------
    serial_number, model
        Which camera, where several are found.
    trigger_line
        Input of the hardware trigger; None: the first of those that the camera has and the node table knows.
    trigger_edge
        Edge of the hardware trigger that starts an exposure.
    buffers
        Frames that the camera's library may hold before it loses one: with 16 the worker may be held up for 177 ms
        at 90 frames a second. All of them take memory.
    slots
        Frames of the ring between the worker and the program; at most half of them are lent to the caller
        without a copy. A slot takes memory once the program lagged that far behind.
    hottest_c
        A camera that tells a higher temperature is not armed; None: never mind. The default is no maker's figure.
    answer_timeout_s, open_timeout_s
        Bound of one operation, and of `open` (which starts a process and loads the vendor's library).
    """

    serial_number: str | None = None
    model: str | None = None
    trigger_line: str | None = None
    trigger_edge: Literal["rising", "falling"] = "rising"
    buffers: Annotated[int, Field(ge=2, le=64)] = 16
    slots: Annotated[int, Field(ge=2, le=64)] = 32
    hottest_c: Annotated[float, Field(gt=0, le=200)] | None = 80.0
    answer_timeout_s: Annotated[float, Field(gt=0, le=60)] = 10.0
    open_timeout_s: Annotated[float, Field(gt=0, le=60)] = 20.0


class HarvestersSettings(CameraOptions):
    """A camera through a GenTL producer.

    Attributes
    ----------
    producer
        The producer's file (``.cti``); None: XIMEA's where it is usually installed, or what the environment
        variable GENICAM_GENTL64_PATH leads to.
    """

    producer: str | None = None


class AravisSettings(CameraOptions):
    """A GigE Vision camera through Aravis, without a vendor's producer.

    Attributes
    ----------
    address
        Address of the camera, e.g. ``"192.168.0.7"``: looking for it would broadcast on every interface.
    library
        File name of Aravis.
    resend
        Ask the camera again for packets that were lost.
    """

    address: str
    library: str = "libaravis-0.8.so.0"
    resend: bool = True
