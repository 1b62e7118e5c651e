"""`run.yaml`: what a run is, as a person reads it."""

from __future__ import annotations

import io
import platform
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, JsonValue
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from irpmd_rig.store.durable import write_text
from irpmd_rig.store.entries import Count, Finite
from irpmd_rig.store.errors import RunFolderError, all_problems

Kind = Literal[
    "measure",
    "reference",
    "calibrate-camera",
    "calibrate-plate",
    "calibrate-geometry",
    "sequence",
    "align",
    "characterise",
]
KINDS: tuple[str, ...] = get_args(Kind)
CALIBRATIONS: tuple[str, ...] = ("calibrate-camera", "calibrate-plate", "calibrate-geometry")

_LARGEST_BYTES = 2_000_000

# YAML reads a number or a date where a person wrote one as a name; a key without a value is an empty text.
Text = Annotated[str, BeforeValidator(lambda value: "" if value is None else str(value))]


class Fringes(BaseModel):
    """Fringe counts (periods across the projector) and phase steps a set."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    counts: Annotated[tuple[Count, ...], Field(min_length=1)]
    steps: Annotated[int, Field(ge=3)]


class Optics(BaseModel):
    """What must be the same for a calibration to hold: camera, its picture and its intrinsics.

    Attributes
    ----------
    camera_serial
        Serial number of the camera.
    size_px
        Width and height of a frame.
    intrinsics
        Id of the camera calibration that was used; None before there is one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    camera_serial: Text
    size_px: tuple[int, int]
    intrinsics: str | None = None


class RunRecord(BaseModel):
    """The content of `run.yaml`. A script that writes a folder by hand gives `kind`, and of the rest what it knows.

    Attributes
    ----------
    kind
        What the run is for.
    id, created
        Given by the store: the folder's name and when it was made.
    name, operator, sample, notes
        As the recipe gives them.
    nominal_steps_mm
        What the steps of the object should be, if it was said.
    fringes
        Fringe counts and phase steps; the default of the manifest's lines.
    positions_mm
        Stage positions of the recipe (physics' s).
    uses
        Kind to id of the calibrations and the reference used, e.g. ``{"reference": "20261122-101500-3fa1c2"}``;
        ``active`` stands for the one that is active when the run is processed.
    optics
        The camera, once it is known.
    recipe
        The recipe as parsed; as text it lies beside, in `recipe.yaml`.
    rig
        The rig file, filled in.
    versions
        Of the software.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Kind
    id: str = ""
    created: datetime | None = None
    name: Text = ""
    operator: Text = ""
    sample: Text = ""
    notes: Text = ""
    nominal_steps_mm: tuple[Finite, ...] = ()
    fringes: Fringes | None = None
    positions_mm: tuple[Finite, ...] = ()
    uses: dict[Kind, str] = Field(default_factory=dict)
    optics: Optics | None = None
    recipe: dict[str, JsonValue] = Field(default_factory=dict)
    rig: dict[str, JsonValue] = Field(default_factory=dict)
    versions: dict[str, str] = Field(default_factory=dict)


def software_versions() -> dict[str, str]:
    """Versions of what computes."""
    packages = ("irpmd-rig", "numpy", "scipy", "opencv-python-headless")
    return {"python": platform.python_version()} | {package: version(package) for package in packages}


def read_record(path: Path) -> RunRecord:
    """Read `run.yaml`.

    Raises
    ------
    RunFolderError
        If there is none, or it is wrong: every problem at once.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RunFolderError(f"{path}: {error.strerror}; a run folder needs a run.yaml") from error
    if len(content) > _LARGEST_BYTES:
        raise RunFolderError(f"{path}: larger than {_LARGEST_BYTES} bytes; it is no run.yaml")
    try:
        parsed = YAML(typ="safe", pure=True).load(content)
        return RunRecord.model_validate(parsed)
    except (YAMLError, ValueError, RecursionError) as error:
        raise RunFolderError(f"{path}: {all_problems(error)}") from error


def write_record(record: RunRecord, path: Path) -> None:
    """Write `run.yaml` durably, whole or not at all."""
    dumper = YAML()
    dumper.default_flow_style = False
    dumper.width = 120
    # Without aliases: another reader may refuse them, as our own reader of recipes does.
    dumper.representer.ignore_aliases = lambda *_: True
    text = io.StringIO()
    dumper.dump(record.model_dump(mode="json", exclude_none=True, exclude_defaults=True), text)
    write_text(path, text.getvalue())
