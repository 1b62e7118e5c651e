"""What the service answers, as JSON; times are seconds since 1970-01-01 UTC where the name ends in `_s`.

A client reads answers with the same models; members that it does not know are ignored.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from drivers.values import StageCondition
from irpmd_rig.acquisition.conditions import DeviceCondition
from irpmd_rig.store.states import Reason, RunState

Finite = Annotated[float, Field(allow_inf_nan=False)]


class Answer(BaseModel):
    """Base of all answers: frozen, made from the daemon's values by the names of their fields."""

    model_config = ConfigDict(frozen=True, from_attributes=True)


class ErrorAt(Answer):
    """One thing that is wrong with a request: its place in it, and what it is."""

    location: tuple[str, ...]
    message: str


class RecipeError(Answer):
    """One thing that is wrong in a document: where, what, and what to do."""

    file: str
    line: int
    column: int
    what: str
    remedy: str


class Holder(Answer):
    """Who holds the lease, and until when."""

    owner: str
    taken_s: Finite
    expires_s: Finite


class ProblemDocument(Answer):
    """A problem document (RFC 9457).

    Attributes
    ----------
    type
        Path of the page that explains this kind of problem; it never changes.
    errors
        Of invalid and recipe-refused: everything that is wrong.
    holder
        Of lease-held: who has the lease.
    run_id
        Of rig-busy: the run that has the instruments.
    reasons
        Of not-ready: every reason.
    device
        Of problems of one instrument: its name.
    """

    type: str
    title: str
    status: int
    detail: str
    instance: str
    errors: tuple[ErrorAt | RecipeError, ...] = ()
    holder: Holder | None = None
    run_id: str | None = None
    reasons: tuple[str, ...] = ()
    device: str | None = None


class Health(Answer):
    """The service is alive."""

    status: Literal["ok"] = "ok"


class Device(Answer):
    """An instrument as it was last seen; detail and remedy say what is wrong and what mends it."""

    kind: Literal["camera", "projector", "stage"]
    driver: str
    state: DeviceCondition
    detail: str
    remedy: str


class Position(Answer):
    """Where a stage is; measured False: computed from what was commanded."""

    position_mm: Finite
    measured: bool


class Limits(Answer):
    """Soft limits of an axis."""

    lower_mm: Finite
    upper_mm: Finite


class Axis(Answer):
    """What an axis is doing; position None: it has no zero."""

    condition: StageCondition
    position: Position | None
    target_mm: Finite | None
    limits: Limits | None


class Rig(Answer):
    """The rig at one moment; `reasons` holds every reason why a run would not begin now."""

    name: str
    simulated: bool
    devices: Mapping[str, Device]
    axes: Mapping[str, Axis]
    lease: Holder | None
    active_run: str | None
    stop_latched: bool
    can_start: bool
    reasons: tuple[str, ...]
    free_bytes: int
    time_s: Finite


class Lease(Answer):
    """A lease; `id` goes into the header `X-Lease`, `overridden` names whom it was taken from."""

    id: str
    owner: str
    taken_s: Finite
    expires_s: Finite
    overridden: str | None


class DeviceStop(Answer):
    """What stopping one instrument achieved.

    Attributes
    ----------
    outcome
        ``stopped``: nothing of it moves, shines or exposes. ``cannot_be_stopped``: it ends by itself, after
        `ends_in_s`. ``unknown``: it could not be told, `error` says why.
    """

    outcome: Literal["stopped", "cannot_be_stopped", "unknown"]
    ends_in_s: Finite
    error: str | None


class Stop(Answer):
    """What a stop achieved, by instrument; it is latched until it is cleared."""

    devices: Mapping[str, DeviceStop]
    stop_latched: Literal[True] = True


class Estimate(Answer):
    """What a run takes."""

    frames: int
    bytes: int
    seconds: Finite
    motion_mm: Mapping[str, Finite]
    prompts: int


class Validation(Answer):
    """Everything that is wrong with a recipe, and what it would do.

    Attributes
    ----------
    ok
        It may run.
    warnings
        What would be refused if it ran now, and may have changed by the time it runs.
    stations
        One line for each station.
    """

    ok: bool
    problems: tuple[RecipeError, ...]
    warnings: tuple[str, ...]
    kind: str | None
    name: str | None
    estimate: Estimate | None
    stations: tuple[str, ...]


class Recipe(Answer):
    """A recipe that ships with the program; `id` is what `POST /runs` takes as its recipe."""

    id: str
    kind: str
    name: str
    text: str


class Progress(Answer):
    """How far a run is."""

    stations_done: int
    stations: int
    frames_done: int
    frames: int
    doing: str


class Prompt(Answer):
    """A question to the operator, and until when it waits."""

    id: int
    text: str
    expires_s: Finite


class Run(Answer):
    """A run at one moment.

    Attributes
    ----------
    state
        None: a folder that was put there by hand.
    reason, detail
        Why it ended badly, from a closed list and in words.
    place
        In the queue, from 0; None: it does not wait.
    asked
        ``pause`` or ``abort``: wanted, and not obeyed yet.
    frames, results
        Frames on disk that count, and names of the results; in a list of runs None and empty.
    """

    id: str
    kind: str
    name: str
    state: RunState | None
    reason: Reason | None
    detail: str
    attempt: int
    created: datetime | None
    changed: datetime | None
    progress: Progress | None
    place: int | None
    prompt: Prompt | None
    asked: str | None
    estimate: Estimate | None
    frames: int | None
    results: tuple[str, ...]


class Queue(Answer):
    """The queue; held: no run starts by itself, and why."""

    held: bool
    why: str
    waiting: tuple[str, ...]
    active_run: str | None


class Optics(Answer):
    """The camera that a calibration holds for."""

    camera_serial: str
    size_px: tuple[int, int]
    intrinsics: str | None


class Calibration(Answer):
    """A calibration or reference; `id` is that of its run, `active` whether recipes that say so get it."""

    id: str
    kind: str
    name: str
    created: datetime | None
    age_days: Finite | None
    active: bool
    optics: Optics | None
    positions_mm: tuple[Finite, ...]
    uses: Mapping[str, str]


class ResultFile(Answer):
    """A file among the results of a run."""

    name: str
    bytes: int
    media_type: str


class Event(Answer):
    """The data of one server-sent event; its id is what `Last-Event-ID` takes."""

    id: int
    time_s: Finite
    kind: str
    run_id: str | None
    data: Mapping[str, Any]


class Region(Answer):
    """A rectangle of the sensor."""

    column_px: int
    row_px: int
    width_px: int
    height_px: int


class CameraInForce(Answer):
    """What the camera is set to; None: not known."""

    exposure_us: Finite | None
    gain_db: Finite | None
    pixel_format: str | None
    region: Region | None
    frame_rate_hz: Finite | None
    trigger: Literal["free", "software", "hardware"]
