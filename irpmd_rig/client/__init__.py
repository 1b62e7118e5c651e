"""Talk to the daemon of a rig from a script: over HTTP, typed, with or without asyncio.

>>> from irpmd_rig.client import Client                                # doctest: +SKIP
>>> with Client() as rig:                                              # doctest: +SKIP
...     done = rig.carry_out(Path("my-measurement.yaml"))
...     depth_mm = rig.array(done.id, "depth_mm.npy")

The methods are named after what they ask of the service; answers are frozen values with units in the names. What the
service refuses is a `ProblemError`. Everything works with curl or any other HTTP client, too.
"""

from irpmd_rig.client._calls import Control, Recipe
from irpmd_rig.client.asynchronous import AsyncClient
from irpmd_rig.client.errors import (
    ClientError,
    NotInTime,
    ProblemError,
    RunFailed,
    ServiceUnreachable,
    TokenUnreadable,
)
from irpmd_rig.client.settings import DEFAULT_TOKEN, DEFAULT_URL
from irpmd_rig.client.synchronous import Client
from irpmd_rig.service.models import (
    Axis,
    Calibration,
    CameraInForce,
    Device,
    DeviceStop,
    Event,
    Health,
    Holder,
    Lease,
    Position,
    Progress,
    Prompt,
    Queue,
    ResultFile,
    Rig,
    Run,
    Stop,
    Validation,
)

__all__ = [
    "DEFAULT_TOKEN",
    "DEFAULT_URL",
    "AsyncClient",
    "Axis",
    "Calibration",
    "CameraInForce",
    "Client",
    "ClientError",
    "Control",
    "Device",
    "DeviceStop",
    "Event",
    "Health",
    "Holder",
    "Lease",
    "NotInTime",
    "Position",
    "ProblemError",
    "Progress",
    "Prompt",
    "Queue",
    "Recipe",
    "ResultFile",
    "Rig",
    "Run",
    "RunFailed",
    "ServiceUnreachable",
    "Stop",
    "TokenUnreadable",
    "Validation",
]
