"""How a LightCommander is spoken to over USB: a profile, read from a file that a lab can fill in.

What TI's documents say about it is not public. Where a profile does not know something it says `unknown`; as
long as it does, or is not enabled, nothing is sent.
"""

from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from drivers.errors import ConfigurationError
from drivers.projector.ti_api import OPERATIONS
from drivers.settings import Settings, nearest, read_file

Unknown = Literal["unknown"]
Number = Literal["u8", "u16", "u32", "f64"]
LayoutKind = Literal["u8", "u16", "u32", "f64", "u16s", "bytes", "text"]

UsbNumber = Annotated[int, Field(ge=0, le=0xFFFF)] | Unknown
EndpointNumber = Annotated[int, Field(ge=0, le=0xFF)] | Unknown
HexBytes = Annotated[str, StringConstraints(pattern=r"^([0-9a-f]{2})+$")]


class FramePart(Settings):
    """One part of a frame, in the order of the wire; `constant` has its bytes as hexadecimal digits."""

    part: Literal["constant", "sequence", "opcode", "status", "length", "payload", "checksum"]
    type: Number | None = None
    bytes: HexBytes | None = None

    @model_validator(mode="after")
    def _complete(self) -> "FramePart":
        needs_type = self.part not in ("constant", "payload")
        if needs_type != (self.type is not None) or (self.part == "constant") != (self.bytes is not None):
            raise ValueError("a constant has `bytes`, the payload neither, every other part a `type`")
        if self.type == "f64":
            raise ValueError("this part is a whole number: u8, u16 or u32")
        return self


class Parameter(Settings):
    """One value of a request, by its name in TI's API."""

    name: str
    type: LayoutKind


class OperationLayout(Settings):
    """How one operation looks: its opcode, the values of its request, the one of its reply."""

    opcode: Annotated[int, Field(ge=0)] | Unknown
    request: tuple[Parameter, ...] | Unknown = ()
    reply: LayoutKind | Unknown | None = None


class UsbProfile(Settings):
    """A profile; `verified` says on what it was ever tried."""

    title: str
    enabled: bool
    verified: str
    vendor_id: UsbNumber
    product_id: UsbNumber
    interface: EndpointNumber
    endpoint_out: EndpointNumber
    endpoint_in: EndpointNumber
    byte_order: Literal["little", "big"] | Unknown
    checksum: Literal["sum", "xor", "none"] | Unknown
    request: tuple[FramePart, ...] | Unknown
    reply: tuple[FramePart, ...] | Unknown
    longest_reply_bytes: Annotated[int, Field(ge=1, le=65536)] | Unknown
    status_done: Annotated[int, Field(ge=0)] | Unknown
    statuses: dict[str, str] = Field(default_factory=dict)
    fault_statuses: tuple[int, ...] = ()
    operations: dict[str, OperationLayout]

    @model_validator(mode="after")
    def _sensible(self) -> "UsbProfile":
        for name, layout in self.operations.items():
            _check_operation(name, layout)
        for title, parts in (("request", self.request), ("reply", self.reply)):
            if parts != "unknown":
                _check_frame(title, [part.part for part in parts], self.checksum)
        return self

    def unknowns(self) -> tuple[str, ...]:
        """Name everything that the profile does not know."""
        found = [name for name, value in self if value == "unknown"]
        found += [name for name in OPERATIONS if name not in self.operations]
        for name, layout in self.operations.items():
            found += [f"{name}.{key}" for key, value in layout if value == "unknown"]
        return tuple(found)


def profile_names() -> tuple[str, ...]:
    """Names of the profiles that come with the driver."""
    folder = files("drivers.projector") / "profiles"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_profile(name: str, *, device: str) -> UsbProfile:
    """Read a profile by its name, or by the path of its file.

    Raises
    ------
    ConfigurationError
        There is none, it does not fit the model, or it may not be used: disabled, or with unknowns.
    """
    if name.endswith((".yaml", ".yml")):
        return _usable(read_file(UsbProfile, Path(name), device=device, setting="profile"), device)
    if name not in profile_names():
        raise ConfigurationError(
            device, f"there is no USB profile {name!r}", nearest(name, profile_names()), ("profile",)
        )
    with as_file(files("drivers.projector") / "profiles" / f"{name}.yaml") as path:
        return _usable(read_file(UsbProfile, path, device=device, setting="profile"), device)


def _usable(profile: UsbProfile, device: str) -> UsbProfile:
    unknowns = profile.unknowns()
    if unknowns:
        listing = ", ".join(unknowns[:6]) + (", ..." if len(unknowns) > 6 else "")
        raise ConfigurationError(
            device,
            f"the USB profile {profile.title!r} leaves {len(unknowns)} things unknown: {listing}",
            "copy it, fill it in from TI's documents (DLPA024, DLPA014, DLPU005) or a capture, and name the copy",
            ("profile",),
        )
    if not profile.enabled:
        raise ConfigurationError(
            device,
            f"the USB profile {profile.title!r} is disabled",
            "set `enabled: true` in it once it was checked on the real box",
            ("profile",),
        )
    return profile


def _check_operation(name: str, layout: OperationLayout) -> None:
    if name not in OPERATIONS:
        raise ValueError(f"unknown operation {name!r}: {nearest(name, tuple(OPERATIONS))}")
    known = dict(OPERATIONS[name].parameters)
    for parameter in () if layout.request == "unknown" else layout.request:
        if parameter.name not in known:
            raise ValueError(f"{name} has no parameter {parameter.name!r}: it has {', '.join(known) or 'none'}")
        accepted = _ACCEPTED[known[parameter.name]]
        if parameter.type not in accepted:
            raise ValueError(f"{name}: {parameter.name} cannot be {parameter.type}, but {' or '.join(accepted)}")
    result = OPERATIONS[name].result
    if layout.reply not in ("unknown", *(_ACCEPTED[result] if result else (None,))):
        raise ValueError(f"{name} cannot reply {layout.reply}")


_WHOLE: tuple[LayoutKind, ...] = ("u8", "u16", "u32")
_ACCEPTED: dict[str, tuple[LayoutKind, ...]] = {
    "byte": _WHOLE,
    "uint16": ("u16", "u32"),
    "uint32": ("u32",),
    "double": ("f64",),
    "enum": _WHOLE,
    "boolean": _WHOLE,
    "string": ("text",),
    "bytes": ("bytes",),
    "uint16s": ("u16s",),
}


def _check_frame(title: str, parts: list[str], checksum: str) -> None:
    if parts.count("payload") != 1 or parts.count("opcode") > 1 or parts.count("length") > 1:
        raise ValueError(f"the {title} has one payload, and at most one opcode and length")
    if ("checksum" in parts) != (checksum != "none") and checksum != "unknown":
        raise ValueError(f"the {title} has a checksum part if, and only if, `checksum` is not none")
    if "checksum" in parts[:-1]:
        raise ValueError(f"the checksum of the {title} is its last part")
    if title == "reply" and not {"status", "length"} <= set(parts):
        raise ValueError("the reply has a status and a length")
    if title == "request" and "opcode" not in parts:
        raise ValueError("the request has an opcode")
