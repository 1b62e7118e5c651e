"""One line of a run's manifest: a frame and how it was taken."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue

Role = Literal["fringes", "white", "black", "plain", "switched", "series"]
Orientation = Literal["x", "y"]
Finite = Annotated[float, Field(allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Label = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[A-Za-z0-9_.-]+$")]


class ManifestEntry(BaseModel):
    """A frame of a run. A script that writes a folder by hand gives `path`, and of the rest what it knows.

    Attributes
    ----------
    path
        File in the run's folder, e.g. ``frames/00000-object.tif``; empty before the frame is written.
    index
        Number of the frame in the run, -1 before it is written; a line without it gets its place in the manifest.
    station
        Number of the stage position (and placement) at which it was taken.
    label
        What stood before the camera: board, plate, sprayed, glass, mirror, object.
    role
        fringes, white, black, plain (no pattern), switched (a time after black became white) or series (frames of one
        pattern, one after the other).
    orientation
        Along which projector axis the fringes vary.
    set, step
        Fringe set and phase step, from 0; None if the frame is no fringe.
    view
        Number of a board's pose, of an exposure or of a delay.
    counts, steps
        Fringe counts of the whole measurement (periods across the projector) and phase steps a set. A line without
        them gets those of `run.yaml`.
    stage1_mm, stage2_mm
        Stage positions (0 = reference position).
    stage1_measured, stage2_measured
        Whether a position was read back, or only commanded.
    exposure_us, led, intensity, bits
        Light and camera: LED name, share of full drive, significant bits of a value.
    time
        When the frame arrived, with time zone.
    frame_id
        The camera's own count.
    checks
        What was checked, by name.
    sha256
        Of the file.
    attempt
        In which attempt of the run it was taken.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str = ""
    index: Annotated[int, Field(ge=-1)] = -1
    station: Annotated[int, Field(ge=0)] = 0
    label: Label = "object"
    role: Role = "fringes"
    orientation: Orientation = "x"
    set: Annotated[int, Field(ge=0)] | None = None
    step: Annotated[int, Field(ge=0)] | None = None
    view: Annotated[int, Field(ge=0)] | None = None
    counts: tuple[Count, ...] | None = None
    steps: Annotated[int, Field(ge=3)] | None = None
    stage1_mm: Finite | None = None
    stage1_measured: bool = False
    stage2_mm: Finite | None = None
    stage2_measured: bool = False
    exposure_us: NotNegative | None = None
    led: str | None = None
    intensity: NotNegative | None = None
    bits: Annotated[int, Field(ge=1, le=16)] | None = None
    time: datetime | None = None
    frame_id: int | None = None
    checks: dict[str, JsonValue] = Field(default_factory=dict)
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    attempt: Annotated[int, Field(ge=1)] = 1

    def line(self) -> str:
        """The entry as one line of JSON, without what it does not know."""
        return json.dumps(self.model_dump(mode="json", exclude_none=True), allow_nan=False)


class Withdrawal(BaseModel):
    """A manifest line that takes frames out again; their files stay.

    Attributes
    ----------
    superseded
        Indices of frames that a later attempt replaces.
    lost
        Indices of frames whose files turned out to be missing or damaged.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    superseded: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()

    def line(self) -> str:
        """The withdrawal as one line of JSON."""
        return json.dumps({key: list(value) for key, value in self if value})


def parse_line(content: dict[str, Any]) -> ManifestEntry | Withdrawal:
    """Read one line; raises ValueError (pydantic's, with all that is wrong) if it is neither."""
    if "superseded" in content or "lost" in content:
        return Withdrawal.model_validate(content)
    if not content.get("path"):
        raise ValueError('a frame needs its path, e.g. {"path": "frames/00000.tif"}')
    return ManifestEntry.model_validate(content)
