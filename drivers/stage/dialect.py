"""What one kind of stage controller says and understands on its serial line: the model of a dialect file."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.errors import ConfigurationError
from drivers.settings import Settings, nearest, read_file

DIALECT_FOLDER = Path(__file__).parent / "dialects"
PLACEHOLDER = re.compile(r"\{(\w+)\}")

ByteOrder = Literal["little", "big"]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


class Line(Settings):
    """Settings of the serial line."""

    baud: Annotated[int, Field(ge=50, le=4_000_000)]
    data_bits: Literal[5, 6, 7, 8] = 8
    parity: Literal["none", "even", "odd"] = "none"
    stop_bits: Literal[1, 2] = 1
    flow_control: Literal["none", "rtscts"] = "none"


class Speed(Settings):
    """One speed of a controller that knows speeds by a code of its own."""

    code: Annotated[int, Field(ge=0)]
    speed_mm_per_s: Positive


class SpeedTable(Settings):
    """Speeds that were measured, one a code."""

    kind: Literal["table"]
    speeds: Annotated[tuple[Speed, ...], Field(min_length=1)]


class SpeedRange(Settings):
    """Speeds that the controller takes in counts per second."""

    kind: Literal["counts_per_s"]
    lowest: Annotated[int, Field(ge=1)]
    highest: Annotated[int, Field(ge=1)]


Speeds = Annotated[SpeedTable | SpeedRange, Field(discriminator="kind")]


class AxisFacts(Settings):
    """What must be known of a controller with its stage; None: not known here.

    Attributes
    ----------
    counts_per_mm
        Counts of the controller to a millimetre of travel.
    byte_order
        Of fields that leave it open.
    speeds
        Which speeds there are.
    ramp_s
        Time that speeding up and slowing down add to a move at constant speed.
    travel_mm
        Length of the stage's mechanical travel.
    """

    counts_per_mm: Positive | None = None
    byte_order: ByteOrder | None = None
    speeds: Speeds | None = None
    ramp_s: NotNegative | None = None
    travel_mm: Positive | None = None


class NumberField(Settings):
    """How a number is written into a command.

    Attributes
    ----------
    format
        ``decimal`` or ``hex`` digits in a text frame, ``integer`` in a binary one.
    width
        Digits, zeros in front (0: as many as it takes), or bytes.
    order
        Byte order of an integer; None: the axis's `byte_order`.
    maximum
        Largest value that may be sent.
    """

    format: Literal["decimal", "hex", "integer"]
    width: Annotated[int, Field(ge=0, le=16)]
    maximum: Annotated[int, Field(ge=1)]
    order: ByteOrder | None = None


class DirectionField(Settings):
    """What stands for towards larger and towards smaller counts: text, or bytes in hex."""

    positive: str
    negative: str


class Fields(Settings):
    """The values that a command's template may hold, as ``{name}``."""

    axis: NumberField
    direction: DirectionField
    counts: NumberField
    speed: NumberField


class Command(Settings):
    """One frame.

    Attributes
    ----------
    send
        Template: text, or bytes in hex, with ``{axis}``, ``{direction}``, ``{counts}``, ``{speed}``.
    acknowledged
        Whether the controller answers yes or no (a question is always answered).
    pause_s
        Silence that the controller needs after it.
    """

    send: Annotated[str, Field(min_length=1)]
    acknowledged: bool = False
    pause_s: NotNegative = 0.0


Commands = Annotated[tuple[Command, ...], Field(min_length=1)]


class Actions(Settings):
    """What the box can do, each as commands in their order; None: it cannot."""

    move: Commands
    set_speed: Commands | None = None
    home: Commands | None = None
    stop: Commands | None = None
    zero: Commands | None = None
    status: Command | None = None
    busy: Command | None = None


class Replies(Settings):
    """How answers look: regular expressions that an answer without its terminator must match as a whole.

    Attributes
    ----------
    status
        With the groups ``position`` (counts), ``busy`` and, where limits are reported, ``limit``.
    busy
        With the group ``busy``.
    busy_value, limit_value
        What those groups hold when it is so.
    """

    terminator: Annotated[str, Field(min_length=1)]
    limit_bytes: Annotated[int, Field(ge=1, le=4096)]
    timeout_s: Positive
    accepted: str
    refused: str
    status: str
    busy: str
    busy_value: str
    limit_value: str

    @field_validator("accepted", "refused", "status", "busy")
    @classmethod
    def _compiles(cls, pattern: str) -> str:
        try:
            re.compile(pattern)
        except re.error as error:
            raise ValueError(f"is no regular expression: {error}") from None
        return pattern

    @model_validator(mode="after")
    def _groups(self) -> Self:
        for pattern, needed in ((self.status, {"position", "busy"}), (self.busy, {"busy"})):
            missing = needed - set(re.compile(pattern).groupindex)
            if missing:
                raise ValueError(f"the pattern {pattern!r} lacks the group {sorted(missing)[0]!r}")
        return self

    @property
    def reports_limits(self) -> bool:
        """Whether a status tells of limit switches."""
        return "limit" in re.compile(self.status).groupindex


class Unverified(Settings):
    """Something that is written here and was never checked on a real box."""

    unverified: Literal[True]
    fact: str
    verify: str


class Dialect(Settings):
    """One kind of controller.

    Attributes
    ----------
    motion
        ``relative``: counts are a distance; ``absolute``: a place.
    go_starts_all_axes
        Whether the command that starts a move also starts other axes on the same line; None: not known.
        Unless it is False, an axis must have its line to itself.
    axis
        Facts that hold for every stage on such a controller; a rig file may set or override each.
    how_to_find
        For each fact that is not known here, how a lab finds it.
    """

    title: str
    source: str
    framing: Literal["text", "binary"]
    terminator: str = ""
    line: Line
    motion: Literal["relative", "absolute"]
    go_starts_all_axes: bool | None
    fields: Fields
    actions: Actions
    replies: Replies | None
    axis: AxisFacts
    how_to_find: dict[str, str]
    unverified: tuple[Unverified, ...]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        known = tuple(Fields.model_fields)
        for command in self.commands():
            for name in PLACEHOLDER.findall(command.send):
                if name not in known:
                    raise ValueError(f"unknown field {name!r} in {command.send!r}; {nearest(name, known)}")
            if command.acknowledged and self.replies is None:
                raise ValueError(f"{command.send!r} is acknowledged, but `replies` is null")
            if self.framing == "binary":
                _check_hex(PLACEHOLDER.sub("", command.send))
        if (self.actions.status or self.actions.busy) and self.replies is None:
            raise ValueError("`status` and `busy` are answered, but `replies` is null")
        if self.actions.home is not None and self.actions.status is None:
            raise ValueError("`home` needs `status`: else nobody knows when it has ended")
        return self

    def commands(self) -> tuple[Command, ...]:
        """All commands of all actions."""
        actions = self.actions
        several = (actions.move, actions.set_speed, actions.home, actions.stop, actions.zero)
        single = (actions.status, actions.busy)
        return (*(c for group in several if group for c in group), *(c for c in single if c))


def load_dialect(name: str, *, device: str) -> Dialect:
    """Read a dialect by its name, or by the path of a file (a name that ends in ``.yaml``).

    Raises
    ------
    ConfigurationError
        There is no such dialect, or its file is wrong: ``file:line:column``.
    """
    if name.endswith(".yaml"):
        return read_file(Dialect, Path(name), device=device, setting="dialect")
    known = tuple(sorted(path.stem for path in DIALECT_FOLDER.glob("*.yaml")))
    if name not in known:
        raise ConfigurationError(
            device,
            f"there is no stage dialect {name!r}",
            f"{nearest(name, known)}; or give the path of a .yaml file",
            ("dialect",),
        )
    return read_file(Dialect, DIALECT_FOLDER / f"{name}.yaml", device=device, setting="dialect")


def _check_hex(text: str) -> None:
    try:
        bytes.fromhex(text)
    except ValueError:
        raise ValueError(f"{text!r} is no sequence of bytes in hex") from None
