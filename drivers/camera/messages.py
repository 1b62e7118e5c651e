"""What travels between the program and a camera's worker, as plain values."""

import base64
from typing import Any

from drivers import errors
from drivers.camera.channel import ChannelError
from drivers.errors import InstrumentError
from drivers.values import CameraCapabilities, CameraSettings, Node, NodeMap, Region

_ERRORS: dict[str, type[InstrumentError]] = {
    kind.__name__: kind
    for kind in (
        errors.NotConnected, errors.DeviceLost, errors.TimedOut, errors.Refused, errors.Unsupported,
        errors.IncompleteFrame, errors.FramesLost, errors.DeviceFault, errors.GarbledReply,
        errors.ConfigurationError,
    )
}  # fmt: skip


def error_message(error: InstrumentError) -> dict[str, Any]:
    """Write an error down."""
    location = list(error.location) if isinstance(error, errors.ConfigurationError) else []
    return {"kind": type(error).__name__, "what": error.what, "remedy": error.remedy, "location": location}


def error_from(device: str, message: Any) -> InstrumentError:
    """Make the error again."""
    try:
        kind = _ERRORS[message["kind"]]
        what, remedy, location = str(message["what"]), str(message["remedy"]), tuple(message["location"])
    except (KeyError, TypeError) as error:
        raise ChannelError(f"no error of the worker: {error}") from None
    if kind is errors.ConfigurationError:
        return errors.ConfigurationError(device, what, remedy, location)
    return kind(device, what, remedy)


def settings_message(settings: CameraSettings) -> dict[str, Any]:
    """Write settings down."""
    region = settings.region
    return {
        "exposure_us": settings.exposure_us,
        "gain_db": settings.gain_db,
        "pixel_format": settings.pixel_format,
        "region": region and [region.column_px, region.row_px, region.width_px, region.height_px],
        "frame_rate_hz": settings.frame_rate_hz,
        "trigger": settings.trigger,
    }


def settings_from(message: Any) -> CameraSettings:
    """Make the settings again."""
    try:
        region = message["region"]
        return CameraSettings(**{**message, "region": None if region is None else Region(*region)})
    except (KeyError, TypeError) as error:
        raise ChannelError(f"no settings: {error}") from None


def capabilities_message(found: CameraCapabilities) -> dict[str, Any]:
    """Write capabilities down."""
    return {name: getattr(found, name) for name in CameraCapabilities.__dataclass_fields__}


def capabilities_from(message: Any) -> CameraCapabilities:
    """Make the capabilities again."""
    try:
        values: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in message.items()
        }
        return CameraCapabilities(**values)
    except (AttributeError, TypeError) as error:
        raise ChannelError(f"no capabilities: {error}") from None


def dump_message(xml: bytes | None, nodes: tuple[Node, ...]) -> dict[str, Any]:
    """Write a node map down."""
    return {
        "xml": None if xml is None else base64.b64encode(xml).decode(),
        "nodes": [[node.name, node.kind, node.access, node.value] for node in nodes],
    }


def dump_from(message: Any) -> NodeMap:
    """Make the node map again."""
    try:
        xml = message["xml"]
        return NodeMap(None if xml is None else base64.b64decode(xml), tuple(Node(*row) for row in message["nodes"]))
    except (KeyError, TypeError, ValueError) as error:
        raise ChannelError(f"no node map: {error}") from None
