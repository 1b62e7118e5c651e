"""The whole truth of a simulated rig, read from one YAML file."""

import difflib
import types
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, Field, ValidationError, model_validator

from sims import yaml_source
from sims.errors import WorldError
from sims.geometry_check import GeometryError, impossibilities
from sims.instruments import (
    Board,
    Camera,
    Glass,
    Lamp,
    Lights,
    Mirror,
    Part,
    Plate,
    Projector,
    Stage1,
    Stage2,
)
from sims.objects import WorldObject


class World(Part):
    """A rig and what stands in it; frame W is frame M at stage1 = 0 (physics notes, section 2).

    Raises
    ------
    pydantic.ValidationError
        A value is missing, unknown or out of range, or the parts do not fit together; `load_world` turns this
        into one `WorldError` with lines and columns.
    """

    seed: Annotated[int, Field(ge=0, lt=2**63)]
    camera: Camera
    projector: Projector
    lights: Lights
    lamp: Lamp
    glass: Glass
    stage1: Stage1
    stage2: Stage2
    mirror: Mirror
    plate: Plate
    board: Board
    objects: dict[str, WorldObject]

    @model_validator(mode="after")
    def _possible(self) -> "World":
        faults = impossibilities(self)
        if faults:
            raise GeometryError(faults)
        return self

    def with_camera_size(self, width_px: int) -> "World":
        """Copy the world, seen by a camera of `width_px` columns and the same field of view.

        Focal lengths, principal point and rows scale; the pixel, the blur in pixels and the light on a pixel
        stay.

        Raises
        ------
        WorldError
            The width is not a whole number from 64 to 8192, or a world with such a camera cannot be.
        """
        if type(width_px) is not int or not 64 <= width_px <= 8192:
            raise WorldError(f"a camera has 64 to 8192 whole columns, not {width_px!r}")
        camera = self.camera
        scale = width_px / camera.size_px[0]
        smaller = camera.model_copy(
            update={
                "size_px": (width_px, round(camera.size_px[1] * scale)),
                "fc_px": (camera.fc_px[0] * scale, camera.fc_px[1] * scale),
                "cc_px": tuple((c + 0.5) * scale - 0.5 for c in camera.cc_px),
            }
        )
        board = self.board.model_copy(update={"margin_px": self.board.margin_px * scale})
        resized = self.model_copy(update={"camera": smaller, "board": board})
        try:
            return World.model_validate(resized.model_dump())
        except ValidationError as error:
            raise WorldError(f"with {width_px} columns: {error}") from None


def load_world(path: str | Path) -> World:
    """Read and validate a world file.

    Raises
    ------
    WorldError
        With every complaint, one a line: `file:line:column: key: what is wrong`.
    """
    if not isinstance(path, str | Path):
        raise WorldError(f"a world file is named by a path, not {path!r}")
    source = yaml_source.read(Path(path))
    try:
        return World.model_validate(source.content)
    except ValidationError as error:
        lines = [line for detail in error.errors() for line in _complaints(source, detail)]
        raise WorldError("\n".join(lines)) from None


def _complaints(source: yaml_source.Source, detail: Any) -> list[str]:
    location, kind = detail["loc"], detail["type"]
    cause = detail.get("ctx", {}).get("error")
    if isinstance(cause, GeometryError):
        return [
            f"{source.position(place, of_key=True)}: {'.'.join(map(str, place))}: {message}"
            for place, message in cause.faults
        ]
    known = source.keys_at(location)
    if kind == "extra_forbidden":
        near = difflib.get_close_matches(str(location[-1]), _keys_of(known[:-1], source.content), 1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        return [f"{source.position(known, of_key=True)}: {_dotted(known)}: unknown key{hint}"]
    if kind == "missing":
        return [f"{source.position(known, of_key=True)}: {_dotted((*known, location[-1]))}: is missing"]
    message = str(cause) if cause is not None else str(detail["msg"])
    message = message[0].lower() + message[1:]
    given = detail["input"]
    if isinstance(given, str | int | float | bool):
        message += f" (got {given!r})"
    return [f"{source.position(known)}: {_dotted(known)}: {message}"]


def _dotted(location: yaml_source.Location) -> str:
    return ".".join(map(str, location)) or "world"


def _keys_of(location: yaml_source.Location, content: Any) -> list[str]:
    """Keys that the model at `location` knows; for an object, those of its own type."""
    kinds: list[type[BaseModel]] = [World]
    for step in location:
        content = content[step]
        kinds = [
            model
            for kind in kinds
            for model in _models_in(kind.model_fields[step].annotation if step in kind.model_fields else kind)
        ]
        if isinstance(content, dict) and "type" in content:
            kinds = [kind for kind in kinds if _has_type(kind, content["type"])] or kinds
    return sorted({name for kind in kinds for name in kind.model_fields})


def _has_type(kind: type[BaseModel], name: object) -> bool:
    return "type" in kind.model_fields and name in get_args(kind.model_fields["type"].annotation)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return [annotation] if issubclass(annotation, BaseModel) else []
    if get_origin(annotation) is None:
        return []
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
