"""The node map: where each feature's registers lie, and the GenICam XML that tells a client so."""

import struct
from dataclasses import dataclass
from typing import Literal

from sims.camera.features import TEXT_BYTES, Feature
from sims.camera.wire import Refusal, Status

XML_ADDRESS = 0x100000
XML_NAME = "irpmd_simulated_xiq.xml"
_FIRST_ADDRESS = 0x1000
_STRIDE = max(TEXT_BYTES, 32)

Value = int | float | str
Part = Literal["value", "minimum", "maximum", "increment"]
_PARTS: tuple[Part, ...] = ("value", "minimum", "maximum", "increment")


@dataclass(frozen=True, slots=True)
class Register:
    """A register: a feature's value or one of its limits."""

    feature: Feature
    part: Part

    @property
    def size(self) -> int:
        """Length in bytes."""
        return TEXT_BYTES if self.feature.kind == "string" else 8

    def encode(self, value: Value) -> bytes:
        """Return the register's bytes for a value."""
        if isinstance(value, str):
            return value.encode()[: TEXT_BYTES - 1].ljust(TEXT_BYTES, b"\0")
        return struct.pack("<d" if self.feature.kind == "float" else "<q", value)

    def decode(self, data: bytes) -> Value:
        """Return the value in a register's bytes."""
        number: Value = struct.unpack("<d" if self.feature.kind == "float" else "<q", data)[0]
        return number


class NodeMap:
    """Addresses of features, and the XML.

    Parameters
    ----------
    features : tuple of Feature
        What the camera offers.
    model : str
        The camera's model, for the XML's head.

    Attributes
    ----------
    registers : dict
        Registers by address.
    xml : bytes
        The description that a client reads.
    """

    def __init__(self, features: tuple[Feature, ...], model: str):
        self.registers: dict[int, Register] = {}
        for number, feature in enumerate(features):
            for part in range(4 if feature.limited else 1):
                address = _FIRST_ADDRESS + number * _STRIDE + 8 * part
                self.registers[address] = Register(feature, _PARTS[part])
        self.xml = _xml(features, model).encode()

    def register(self, address: int, size: int) -> Register:
        """Register at an address.

        Raises
        ------
        Refusal
            If there is no register of that size.
        """
        register = self.registers.get(address)
        if register is None or register.size != size:
            raise Refusal(Status.INVALID_ADDRESS, f"there is no register of {size} bytes at 0x{address:x}")
        return register


def _element(tag: str, text: object) -> str:
    return f"<{tag}>{text}</{tag}>"


def _register_xml(kind: str, name: str, address: int, feature: Feature, access: str) -> str:
    size = TEXT_BYTES if feature.kind == "string" else 8
    body = (
        _element("Visibility", feature.visibility) * (kind == "StringReg")
        + _element("Address", f"0x{address:X}")
        + _element("Length", size)
        + _element("AccessMode", access)
        + _element("pPort", "Device")
        + _element("Cachable", "NoCache")
    )
    if kind == "IntReg":
        body += _element("Sign", "Signed")
    if kind in ("IntReg", "FloatReg"):
        body += _element("Endianess", "LittleEndian")
    return f'<{kind} Name="{name}">{body}</{kind}>'


def _enumeration_body(feature: Feature) -> str:
    return "".join(
        f'<EnumEntry Name="{name}">{_element("Value", value)}</EnumEntry>' for name, value in feature.entries
    ) + _element("pValue", f"{feature.name}Reg")


def _value_body(feature: Feature) -> str:
    body = _element("pValue", f"{feature.name}Reg")
    if feature.kind == "command":
        return body + _element("CommandValue", 1)
    if feature.kind == "boolean":
        return body + _element("OnValue", 1) + _element("OffValue", 0)
    if feature.limited:
        body += _element("pMin", f"{feature.name}_MinReg") + _element("pMax", f"{feature.name}_MaxReg")
        if feature.kind == "integer":
            body += _element("pInc", f"{feature.name}_IncReg")
    return body + (_element("Unit", feature.unit) if feature.unit else "")


def _feature_xml(feature: Feature, address: int, selected: list[str]) -> list[str]:
    if feature.kind == "string":
        return [_register_xml("StringReg", feature.name, address, feature, feature.access)]
    tag = feature.kind.capitalize()
    body = _element("Visibility", feature.visibility)
    if feature.locked:
        body += _element("pIsLocked", "TLParamsLocked")
    body += _enumeration_body(feature) if feature.kind == "enumeration" else _value_body(feature)
    body += "".join(_element("pSelected", name) for name in selected)
    register = "FloatReg" if feature.kind == "float" else "IntReg"
    lines = [
        f'<{tag} Name="{feature.name}">{body}</{tag}>',
        _register_xml(register, f"{feature.name}Reg", address, feature, feature.access),
    ]
    if feature.limited:
        limits = ("Min", "Max", "Inc") if feature.kind == "integer" else ("Min", "Max")
        lines += [
            _register_xml(register, f"{feature.name}_{limit}Reg", address + 8 * (1 + number), feature, "RO")
            for number, limit in enumerate(limits)
        ]
    return lines


def _xml(features: tuple[Feature, ...], model: str) -> str:
    categories: dict[str, list[str]] = {}
    lines = []
    for number, feature in enumerate(features):
        categories.setdefault(feature.category, []).append(feature.name)
        selected = [other.name for other in features if other.selector == feature.name]
        lines += _feature_xml(feature, _FIRST_ADDRESS + number * _STRIDE, selected)
    for category, names in {"Root": list(categories), **categories}.items():
        members = "".join(_element("pFeature", name) for name in names)
        lines.append(f'<Category Name="{category}">{members}</Category>')
    guid = "9f9c1c3e-5c0d-4b6e-8d63-2b9a4c1d7e10"
    head = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<RegisterDescription xmlns="http://www.genicam.org/GenApi/Version_1_1"'
        f' ModelName="{model.replace("-", "_")}" VendorName="simulated" StandardNameSpace="None"'
        ' SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0"'
        ' MajorVersion="1" MinorVersion="0" SubMinorVersion="0"'
        f' ProductGuid="{guid}" VersionGuid="{guid}" ToolTip="Simulated camera">\n'
    )
    return head + "\n".join(lines) + '\n<Port Name="Device"/>\n</RegisterDescription>\n'
