"""One axis: its settings in a rig file, and what they and its dialect come to."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from drivers.errors import ConfigurationError, LimitReached, Refused
from drivers.stage.dialect import (
    AxisFacts,
    ByteOrder,
    Dialect,
    Line,
    NotNegative,
    NumberField,
    Positive,
    SpeedRange,
    SpeedTable,
)
from drivers.stage.frames import Encoder, Values
from drivers.values import StageCapabilities


class SerialStageSettings(AxisFacts):
    """Settings of one axis in a rig file; facts of the dialect may be set or overridden here.

    Attributes
    ----------
    port
        Device file, or ``socket://host:port``.
    dialect
        Name of a dialect, or the path of a ``.yaml`` file.
    axis
        The controller's number of the axis.
    sign
        1: larger counts are larger positions; -1: smaller ones.
    limits_mm
        Soft limits, lower and upper.
    speed_mm_per_s
        Speed after `open`.
    home_position_mm
        Position of the place where homing ends.
    in_position_mm
        A move has succeeded if it ends no farther from its target.
    settle_s
        Time from the end of motion until the stage stands still enough to measure.
    progress_timeout_s
        A move that makes no progress for so long has failed.
    home_timeout_s
        Bound of `home`.
    reconnect_s
        How long an operation tries to open a lost line again.
    accept_no_stop
        The user's acknowledgement that software cannot stop this stage; needed where that is so.
    moving_at_open_s
        Without read-back: for how long a motion may go on that an earlier program began; none: for as long as the way
        between the limits takes. 0 where nothing can move.
    line, go_starts_all_axes
        Override the dialect's.
    """

    port: Annotated[str, Field(min_length=1)]
    dialect: Annotated[str, Field(min_length=1)]
    axis: Annotated[int, Field(ge=0)] = 1
    sign: Literal[1, -1]
    limits_mm: tuple[float, float]
    speed_mm_per_s: Positive
    home_position_mm: float = 0.0
    in_position_mm: Positive = 0.01
    settle_s: NotNegative = 0.2
    progress_timeout_s: Positive = 2.0
    home_timeout_s: Positive = 120.0
    reconnect_s: NotNegative = 5.0
    accept_no_stop: bool = False
    moving_at_open_s: NotNegative | None = None
    line: Line | None = None
    go_starts_all_axes: bool | None = None

    @field_validator("limits_mm")
    @classmethod
    def _ordered(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if not limits[0] < limits[1]:
            raise ValueError("give the lower limit first and a larger upper one")
        return limits


@dataclass(frozen=True, slots=True)
class Scale:
    """Counts of a controller and millimetres of an axis whose zero counts lie at `zero_mm`."""

    counts_per_mm: float
    sign: int
    zero_mm: float

    def to_mm(self, counts: float) -> float:
        """Position of a number of counts."""
        return self.sign * counts / self.counts_per_mm + self.zero_mm

    def to_counts(self, position_mm: float) -> int:
        """Nearest counts to a position."""
        return round(self.sign * (position_mm - self.zero_mm) * self.counts_per_mm)


@dataclass(frozen=True, slots=True)
class Drive:
    """A speed as the controller is told it, and as it is."""

    code: int
    speed_mm_per_s: float


@dataclass(frozen=True, slots=True)
class Axis:
    """Everything that is known of one axis."""

    device: str
    settings: SerialStageSettings
    dialect: Dialect
    line: Line
    counts_per_mm: float
    speeds: SpeedTable | SpeedRange
    ramp_s: float
    byte_order: ByteOrder | None

    @property
    def alone(self) -> bool:
        """Whether the axis must have its line to itself."""
        override = self.settings.go_starts_all_axes
        return (self.dialect.go_starts_all_axes if override is None else override) is not False

    def capabilities(self) -> StageCapabilities:
        """Tell what the axis can do, as far as its dialect knows."""
        dialect, actions = self.dialect, self.dialect.actions
        return StageCapabilities(
            model=dialect.title,
            speed_range_mm_per_s=self.speed_range_mm_per_s(),
            can_home=actions.home is not None,
            can_stop=actions.stop is not None,
            reads_position=actions.status is not None,
            reads_limits=dialect.replies is not None and dialect.replies.reports_limits,
            unverified=tuple(f"{entry.fact}: {entry.verify}" for entry in dialect.unverified),
        )

    def encoder(self) -> Encoder:
        """Writer of this axis's frames."""
        return Encoder(self.device, self.dialect, self.byte_order)

    def preview(self, counts: int, drive: Drive) -> tuple[bytes, ...]:
        """Frames of a move by (or, in an absolute dialect, to) a number of counts."""
        values = Values(self.settings.axis, counts, drive.code)
        return tuple(self.encoder().encode(command, values) for command in self.dialect.actions.move)

    def check_position(self, position_mm: float) -> None:
        """Check a target before anything is sent.

        Raises
        ------
        Refused
            Not a finite number.
        LimitReached
            Outside the soft limits.
        """
        if not math.isfinite(position_mm):
            raise Refused(self.device, f"a position of {position_mm} mm is refused", "give a number")
        lower_mm, upper_mm = self.settings.limits_mm
        if not lower_mm <= position_mm <= upper_mm:
            raise LimitReached(
                self.device,
                f"{position_mm:g} mm is outside the soft limits",
                f"give {lower_mm:g} to {upper_mm:g} mm",
            )

    @property
    def window_counts(self) -> float:
        """In-position window, in counts; half a count is the rounding of a target itself."""
        return max(self.settings.in_position_mm * self.counts_per_mm, 0.5)

    def scale(self, zero_mm: float) -> Scale:
        """Scale of the axis once its zero is known."""
        return Scale(self.counts_per_mm, self.settings.sign, zero_mm)

    def speed_range_mm_per_s(self) -> tuple[float, float]:
        """Slowest and fastest speed."""
        if isinstance(self.speeds, SpeedTable):
            known = [entry.speed_mm_per_s for entry in self.speeds.speeds]
            return min(known), max(known)
        return self.speeds.lowest / self.counts_per_mm, self.speeds.highest / self.counts_per_mm

    def drive(self, speed_mm_per_s: float) -> Drive:
        """Find the nearest speed that the controller has.

        Raises
        ------
        Refused
            Slower than the slowest, or faster than the fastest.
        """
        slowest, fastest = self.speed_range_mm_per_s()
        if not slowest <= speed_mm_per_s <= fastest:
            raise Refused(
                self.device,
                f"a speed of {speed_mm_per_s:g} mm/s is out of range",
                f"give {slowest:g} to {fastest:g} mm/s",
            )
        if isinstance(self.speeds, SpeedTable):
            entry = min(self.speeds.speeds, key=lambda speed: abs(speed.speed_mm_per_s - speed_mm_per_s))
            return Drive(entry.code, entry.speed_mm_per_s)
        code = min(max(round(speed_mm_per_s * self.counts_per_mm), self.speeds.lowest), self.speeds.highest)
        return Drive(code, code / self.counts_per_mm)


def resolve(device: str, settings: SerialStageSettings, dialect: Dialect) -> Axis:
    """Put the rig file's settings over the dialect's facts.

    Raises
    ------
    ConfigurationError
        A fact that neither knows, or settings that do not fit the dialect.
    """
    facts = {name: _fact(device, name, settings, dialect) for name in ("counts_per_mm", "speeds", "ramp_s")}
    order = settings.byte_order or dialect.axis.byte_order
    if order is None and _leaves_order_open(dialect):
        raise _unknown(device, "byte_order", dialect)
    if dialect.actions.stop is None and not settings.accept_no_stop:
        raise ConfigurationError(
            device,
            f"software cannot stop a stage on a {dialect.title}",
            "have an emergency switch within reach, then acknowledge it by accept_no_stop: true",
            ("accept_no_stop",),
        )
    travel_mm = settings.travel_mm or dialect.axis.travel_mm
    lower_mm, upper_mm = settings.limits_mm
    if travel_mm is not None and upper_mm - lower_mm > travel_mm:
        raise ConfigurationError(
            device,
            f"the soft limits are {upper_mm - lower_mm:g} mm apart, more than the travel of {travel_mm:g} mm",
            "narrow limits_mm",
            ("limits_mm",),
        )
    if settings.axis > dialect.fields.axis.maximum:
        largest = dialect.fields.axis.maximum
        raise ConfigurationError(device, f"there is no axis {settings.axis}", f"axis is at most {largest}", ("axis",))
    line = settings.line or dialect.line
    axis = Axis(device, settings, dialect, line, byte_order=order, **facts)
    try:
        axis.drive(settings.speed_mm_per_s)
    except Refused as error:
        raise ConfigurationError(device, error.what, error.remedy, ("speed_mm_per_s",)) from None
    return axis


def _fact(device: str, name: str, settings: SerialStageSettings, dialect: Dialect) -> Any:
    value = getattr(settings, name)
    value = getattr(dialect.axis, name) if value is None else value
    if value is None:
        raise _unknown(device, name, dialect)
    return value


def _leaves_order_open(dialect: Dialect) -> bool:
    fields = (dialect.fields.axis, dialect.fields.counts, dialect.fields.speed)
    return any(_is_open(field) for field in fields)


def _is_open(field: NumberField) -> bool:
    return field.format == "integer" and field.width > 1 and field.order is None


def _unknown(device: str, name: str, dialect: Dialect) -> ConfigurationError:
    how = dialect.how_to_find.get(name, "see the controller's manual")
    return ConfigurationError(device, f"{name} of this axis is not known: set it", how, (name,))
