"""Frames of a LightCommander's USB profile: written and read; whatever comes, a reply or a typed error."""

import struct
from dataclasses import dataclass

import numpy as np

from drivers.errors import GarbledReply
from drivers.projector.ti_api import Result, Value
from drivers.projector.usb_profile import FramePart, LayoutKind, OperationLayout, Parameter, UsbProfile

_CODES = {"u8": "B", "u16": "H", "u32": "I", "f64": "d"}
_SIZES = {"u8": 1, "u16": 2, "u32": 4, "f64": 8}


class StaleReply(Exception):
    """The reply to another request than the last one."""


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply whose frame is sound."""

    status: int
    payload: bytes


def encode_request(profile: UsbProfile, layout: OperationLayout, sequence: int, values: dict[str, Value]) -> bytes:
    """Return the frame of one request.

    Parameters
    ----------
    profile, layout
        A profile without unknowns, and the layout of the operation in it.
    sequence
        Number of the request, 0 to 255.
    values
        The values of its parameters, by their names in TI's API.
    """
    order = _order(profile)
    payload = b"".join(_encode(order, parameter.type, values[parameter.name]) for parameter in _parameters(layout))
    numbers = {"sequence": sequence, "opcode": int(layout.opcode), "length": len(payload)}
    frame = bytearray()
    for part in _parts(profile.request):
        if part.bytes is not None:
            frame += bytes.fromhex(part.bytes)
        elif part.part == "payload":
            frame += payload
        elif part.type is not None:
            value = checksum(profile, part.type, bytes(frame)) if part.part == "checksum" else numbers[part.part]
            frame += struct.pack(order + _CODES[part.type], value)
    return bytes(frame)


def decode_reply(profile: UsbProfile, device: str, layout: OperationLayout, sequence: int, frame: bytes) -> Reply:
    """Take a reply apart.

    Raises
    ------
    GarbledReply
        It is no sound reply.
    StaleReply
        It is a sound reply to another request.
    """
    order, at, numbers = _order(profile), 0, {"length": 0, "status": 0}
    payload = b""
    for part in _parts(profile.reply):
        size = len(bytes.fromhex(part.bytes)) if part.bytes else _SIZES[part.type] if part.type else numbers["length"]
        piece = frame[at : at + size]
        if len(piece) != size:
            raise _garbled(device, "a reply ends early", frame)
        if part.bytes is not None and piece != bytes.fromhex(part.bytes):
            raise _garbled(device, "a reply begins wrongly", frame)
        if part.part == "payload":
            payload = piece
        elif part.type is not None:
            numbers[part.part] = struct.unpack(order + _CODES[part.type], piece)[0]
            if part.part == "checksum" and numbers["checksum"] != checksum(profile, part.type, frame[:at]):
                raise _garbled(device, "a reply has a wrong checksum", frame)
        at += size
    if at != len(frame):
        raise _garbled(device, "a reply is too long", frame)
    expected = {"sequence": sequence, "opcode": layout.opcode}
    if any(numbers.get(name, value) != value for name, value in expected.items()):
        raise StaleReply
    return Reply(numbers["status"], payload)


def decode_result(profile: UsbProfile, device: str, layout: OperationLayout, payload: bytes) -> Result:
    """Return the value in the payload of a reply; GarbledReply if it holds none or another."""
    kind = layout.reply
    if kind is None:
        if payload:
            raise _garbled(device, "a reply holds more than it may", payload)
        return None
    if kind == "text":
        try:
            return payload.rstrip(b"\0").decode("ascii")
        except UnicodeDecodeError:
            raise _garbled(device, "a reply is no text", payload) from None
    if len(payload) != _SIZES[kind]:
        raise _garbled(device, f"a reply holds {len(payload)} bytes instead of {_SIZES[kind]}", payload)
    value: int | float = struct.unpack(_order(profile) + _CODES[kind], payload)[0]
    return value


def checksum(profile: UsbProfile, kind: str, data: bytes) -> int:
    """Return the checksum over `data`, as wide as its part of the frame."""
    values = np.frombuffer(data, np.uint8)
    if profile.checksum == "sum":
        return int(values.sum(dtype=np.uint64)) % (1 << 8 * _SIZES[kind])
    return int(np.bitwise_xor.reduce(values))


def _encode(order: str, kind: LayoutKind, value: Value) -> bytes:
    if isinstance(value, bytes):
        return value
    if isinstance(value, str):
        return value.encode("ascii")
    if isinstance(value, tuple):
        return struct.pack(f"{order}{len(value)}H", *value)
    return struct.pack(order + _CODES[kind], value if kind == "f64" else int(value))


def _order(profile: UsbProfile) -> str:
    return "<" if profile.byte_order == "little" else ">"


def _parts(parts: tuple[FramePart, ...] | str) -> tuple[FramePart, ...]:
    # A profile without unknowns has its frames; `load_profile` lets no other through.
    return () if isinstance(parts, str) else parts


def _parameters(layout: OperationLayout) -> tuple[Parameter, ...]:
    return () if isinstance(layout.request, str) else layout.request


def _garbled(device: str, what: str, frame: bytes) -> GarbledReply:
    return GarbledReply(device, f"{what}: {frame[:24].hex(' ')}", "retry; look at cable and profile if it comes again")
