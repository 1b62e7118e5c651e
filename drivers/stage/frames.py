"""Bytes of a dialect: from commands and values to frames, from answers to what they say."""

import re
from dataclasses import dataclass

from drivers.errors import ConfigurationError, GarbledReply, Refused
from drivers.stage.dialect import (
    PLACEHOLDER,
    ByteOrder,
    Command,
    Dialect,
    DirectionField,
    NumberField,
    Replies,
)


@dataclass(frozen=True, slots=True)
class Values:
    """What one frame may need.

    Attributes
    ----------
    axis
        Address of the axis.
    counts
        Signed distance or place; a frame carries sign and magnitude apart.
    speed
        Code, or counts per second.
    """

    axis: int
    counts: int = 0
    speed: int = 0


@dataclass(frozen=True, slots=True)
class Status:
    """What a controller tells of an axis."""

    counts: int
    busy: bool
    at_limit: bool


@dataclass(frozen=True, slots=True)
class Encoder:
    """Writes frames in one dialect.

    Attributes
    ----------
    byte_order
        Of the fields that leave it open; None: not known.
    """

    device: str
    dialect: Dialect
    byte_order: ByteOrder | None

    def encode(self, command: Command, values: Values) -> bytes:
        """One frame, as it goes onto the line.

        Raises
        ------
        Refused
            A value that does not fit its field.
        ConfigurationError
            A field whose byte order nobody has set.
        """
        text = PLACEHOLDER.sub(lambda found: self._field(found.group(1), values), command.send)
        if self.dialect.framing == "binary":
            return bytes.fromhex(text)
        return (text + self.dialect.terminator).encode("ascii")

    def _field(self, name: str, values: Values) -> str:
        field: NumberField | DirectionField = getattr(self.dialect.fields, name)
        value: int = getattr(values, "counts" if name == "direction" else name)
        if isinstance(field, DirectionField):
            return field.positive if value >= 0 else field.negative
        return self._number(name, field, abs(value))

    def _number(self, name: str, field: NumberField, value: int) -> str:
        if value > field.maximum:
            raise Refused(
                self.device,
                f"{value} is too large for the field {name!r} of the controller",
                f"at most {field.maximum} can be sent in one command: move less far or slower",
            )
        if field.format == "decimal":
            return f"{value:0{field.width}d}"
        if field.format == "hex":
            return f"{value:0{field.width}X}"
        return self._integer(name, field, value)

    def _integer(self, name: str, field: NumberField, value: int) -> str:
        order = field.order or self.byte_order
        if order is None:
            raise ConfigurationError(
                self.device,
                f"the byte order of the field {name!r} is not known",
                "set byte_order to little or big",
                ("byte_order",),
            )
        return value.to_bytes(field.width, order).hex()


class ReplyReader:
    """Gathers one answer from pieces as they come; nothing is kept beyond the longest answer there is."""

    def __init__(self, device: str, replies: Replies) -> None:
        self._device = device
        self._terminator = replies.terminator.encode("ascii")
        self._limit = replies.limit_bytes
        self._gathered = b""

    @property
    def gathered(self) -> bytes:
        """What came so far."""
        return self._gathered

    def feed(self, piece: bytes) -> bytes | None:
        """Take a piece; returns the answer without its terminator once it is whole, else None.

        Raises
        ------
        GarbledReply
            More bytes than any answer has, and no end.
        """
        self._gathered += piece
        answer, terminator, _ = self._gathered.partition(self._terminator)
        if len(answer) > self._limit or (not terminator and len(self._gathered) > self._limit):
            raise GarbledReply(
                self._device,
                f"the controller keeps sending: {_shown(self._gathered)}",
                "check baud rate and dialect, and that no other instrument is on this line",
            )
        return answer if terminator else None


def read_acknowledge(device: str, replies: Replies, answer: bytes, frame: bytes) -> None:
    """Check the answer to a command.

    Raises
    ------
    Refused
        The controller refuses the command.
    GarbledReply
        Neither yes nor no.
    """
    text = _text(device, answer)
    if re.fullmatch(replies.refused, text):
        raise Refused(
            device,
            f"the controller refuses {_shown(frame)}",
            "check that it is idle, in remote mode and not at a limit",
        )
    if not re.fullmatch(replies.accepted, text):
        raise _garbled(device, answer)


def read_status(device: str, replies: Replies, answer: bytes) -> Status:
    """Read the answer to a question for the status.

    Raises
    ------
    GarbledReply
        It does not match the dialect's pattern.
    """
    found = re.fullmatch(replies.status, _text(device, answer))
    if found is None:
        raise _garbled(device, answer)
    groups = found.groupdict()
    try:
        counts = int(re.sub(r"\s", "", groups["position"]))
    except ValueError:
        raise _garbled(device, answer) from None
    return Status(counts, groups["busy"] == replies.busy_value, groups.get("limit") == replies.limit_value)


def read_busy(device: str, replies: Replies, answer: bytes) -> bool:
    """Read the answer to the question whether the controller is busy.

    Raises
    ------
    GarbledReply
        It does not match the dialect's pattern.
    """
    found = re.fullmatch(replies.busy, _text(device, answer))
    if found is None:
        raise _garbled(device, answer)
    return found.group("busy") == replies.busy_value


def _text(device: str, answer: bytes) -> str:
    try:
        return answer.decode("ascii")
    except UnicodeDecodeError:
        raise _garbled(device, answer) from None


def _garbled(device: str, answer: bytes) -> GarbledReply:
    return GarbledReply(
        device,
        f"the controller answered {_shown(answer)}",
        "check baud rate, cable and that the dialect is that of this controller",
    )


def _shown(data: bytes) -> str:
    return repr(data[:40])[1:] + ("..." if len(data) > 40 else "")
