"""What the service is asked, as JSON; unknown members are refused."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.values import LED_INTENSITY_LIMIT, CameraSettings, Led, Region
from irpmd_rig.acquisition.lease import LONGEST_LEASE_S, OWNER_LIMIT

Millimetres = Annotated[float, Field(ge=-10_000, le=10_000)]
LeaseSeconds = Annotated[float, Field(gt=0, le=LONGEST_LEASE_S)]
PersonName = Annotated[str, Field(min_length=1, max_length=OWNER_LIMIT)]
Pixels = Annotated[int, Field(ge=0, le=100_000)]


class Order(BaseModel):
    """Base of all bodies: exact types, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class NamedRecipe(Order):
    """A recipe that ships with the program, by its id."""

    recipe: Annotated[str, Field(max_length=100)]


class InlineRecipe(Order):
    """A recipe as YAML text, of at most 100 kB."""

    text: str


class TakeLease(Order):
    """Take the lease; override takes it away from whoever has it, and that is recorded."""

    owner: PersonName
    duration_s: LeaseSeconds = 600.0
    override: bool = False


class RenewLease(Order):
    """Let the lease end so many seconds from now."""

    duration_s: LeaseSeconds = 600.0


class QueueAction(Order):
    """Hold the queue, or let it go on."""

    action: Literal["hold", "resume"]


class RunAction(Order):
    """Act on a run; answer is for the operator's prompt, of that id if one is given."""

    action: Literal["abort", "pause", "resume", "answer", "retry"]
    answer: Literal["done", "abort"] = "done"
    prompt: Annotated[int, Field(ge=0, le=2**31)] | None = None


class RegionOrder(Order):
    """A rectangle of the sensor, from its upper left corner."""

    column_px: Pixels
    row_px: Pixels
    width_px: Annotated[int, Field(ge=1, le=100_000)]
    height_px: Annotated[int, Field(ge=1, le=100_000)]


class CameraOrder(Order):
    """What the camera is to be set to; null: what it has."""

    exposure_us: Annotated[float, Field(gt=0, le=10_000_000)] | None = None
    gain_db: Annotated[float, Field(ge=-100, le=100)] | None = None
    pixel_format: Annotated[str, Field(max_length=40, pattern="^[A-Za-z0-9_]+$")] | None = None
    region: RegionOrder | None = None
    frame_rate_hz: Annotated[float, Field(gt=0, le=100_000)] | None = None

    def settings(self) -> CameraSettings:
        """Return the same as the driver takes it."""
        region = None if self.region is None else Region(**self.region.model_dump())
        return CameraSettings(self.exposure_us, self.gain_db, self.pixel_format, region, self.frame_rate_hz)


class ShowOrder(Order):
    """Show white, black, or step `step` of `steps` of fringes, `count` periods along `axis`."""

    picture: Literal["white", "black", "fringes"]
    count: Annotated[float, Field(gt=0, le=1000)] = 64.0
    step: Annotated[int, Field(ge=0, le=63)] = 0
    steps: Annotated[int, Field(ge=3, le=64)] = 4
    axis: Literal["x", "y"] = "x"

    @model_validator(mode="after")
    def _step_is_one_of_the_steps(self) -> ShowOrder:
        if self.step >= self.steps:
            raise ValueError(f"step {self.step} of {self.steps}: give 0 to {self.steps - 1}")
        return self


class LedOrder(Order):
    """Light one LED, all others off; 0 is off."""

    led: Annotated[Led, Field(strict=False)]
    intensity: Annotated[float, Field(ge=0, le=LED_INTENSITY_LIMIT)]


class ParkOrder(Order):
    """Park the mirrors, or make them ready again."""

    parked: bool


class MoveOrder(Order):
    """Move a stage to a position, in mm of the rig file's axis."""

    position_mm: Millimetres


class ZeroOrder(Order):
    """Call the place where a stage stands `position_mm`, on the word of a person."""

    position_mm: Millimetres
    confirmed_by: PersonName
