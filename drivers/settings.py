"""Settings of drivers, and the files that they name: typed models whose complaints name a line."""

import difflib
from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

from drivers.errors import ConfigurationError

FILE_LIMIT_BYTES = 100_000
DEPTH_LIMIT = 12

Location = tuple[str | int, ...]


class Settings(BaseModel):
    """Base of every model of settings: frozen, exact types, unknown keys refused, sequences are tuples."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=BaseModel)


def checked(model: type[Model], values: Mapping[str, Any], *, device: str, place: str = "") -> Model:
    """Validate plain values (dicts, lists or tuples, scalars) against a model.

    Parameters
    ----------
    model
        What they must fit.
    values
        What a rig file, dialect or profile holds.
    device
        Name of the instrument that they are for.
    place
        Put before the message, e.g. a file's name.

    Raises
    ------
    ConfigurationError
        The first thing that is wrong, with what is accepted; `location` is its path in `values`.
    """
    try:
        return model.model_validate(_tuples(values))
    except ValidationError as error:
        # A misspelt key is the cause of the missing one that is told first.
        errors = error.errors(include_url=False)
        worst = min(errors, key=lambda found: found["type"] != "extra_forbidden")
    location = _written(values, worst)
    what, remedy = _complaint(model, worst, ".".join(str(step) for step in location))
    raise ConfigurationError(device, f"{place}: {what}" if place else what, remedy, location)


def read_file(model: type[Model], path: Path, *, device: str, setting: str = "") -> Model:
    """Read one YAML file into a model; what is wrong is told as ``name:line:column``.

    Parameters
    ----------
    model
        What it must fit.
    path
        The file.
    device
        Name of the instrument that it is for.
    setting
        The setting that names it, for the errors' `location`.

    Raises
    ------
    ConfigurationError
        It cannot be read, is no YAML of plain values, or does not fit the model.
    """
    try:
        tree = _parsed(path, device)
        try:
            return checked(model, _plain(tree), device=device)
        except ConfigurationError as error:
            line, column = _position(tree, error.location)
            what = f"{path.name}:{line}:{column}: {error.what}"
            raise ConfigurationError(device, what, error.remedy) from None
    except ConfigurationError as error:
        # Not where in that file, but what in the rig file is to blame.
        error.location = (setting,) if setting else ()
        raise


def nearest(word: str, known: tuple[str, ...]) -> str:
    """Say what `word` may have meant: the nearest of the known names, and all of them."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    listing = "known are: " + ", ".join(sorted(known)) if known else "none are known"
    return f"did you mean {close[0]!r}? {listing}" if close else listing


def _written(values: Any, error: ErrorDetails) -> Location:
    """Leave out of a location what is not in the values: a validator's marks for the members of a union."""
    kept: list[str | int] = []
    last = len(error["loc"]) - 1
    for depth, step in enumerate(error["loc"]):
        if (isinstance(values, Mapping) and step in values) or (
            isinstance(values, list | tuple) and isinstance(step, int) and step < len(values)
        ):
            values = values[step]  # type: ignore[index]
            kept.append(step)
        elif depth == last and error["type"] == "missing":
            kept.append(step)
    return tuple(kept)


def _complaint(model: type[BaseModel], error: ErrorDetails, path: str) -> tuple[str, str]:
    location = error["loc"]
    if error["type"] == "extra_forbidden":
        return f"unknown key {path!r}", nearest(str(location[-1]), _keys_at(model, location[:-1]))
    if error["type"] == "missing":
        return f"{path!r} is missing", f"set {path}"
    message = error["msg"].removeprefix("Value error, ")
    if not path:
        return message, "correct the settings"
    return f"{path!r} is wrong: {message}", f"correct {path}"


def _keys_at(model: type[BaseModel], location: Location) -> tuple[str, ...]:
    candidates: list[Any] = [model]
    for step in location:
        candidates = [found for candidate in candidates for found in _descend(candidate, step)] or candidates
    keys = {key for kind in candidates if _is_model(kind) for key in kind.model_fields}
    return tuple(sorted(keys))


def _descend(kind: Any, step: str | int) -> list[Any]:
    if _is_model(kind):
        field = kind.model_fields.get(str(step))
        return _alternatives(field.annotation) if field else []
    return [part for argument in get_args(kind) for part in _alternatives(argument)]


def _alternatives(annotation: Any) -> list[Any]:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _alternatives(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return [part for argument in get_args(annotation) for part in _alternatives(argument)]
    return [annotation]


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _tuples(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list | tuple) else value


def _parsed(path: Path, device: str) -> CommentedMap:
    mend = "give a YAML file of plain keys and values"
    try:
        with path.open("rb") as file:
            text = file.read(FILE_LIMIT_BYTES + 1)
    except OSError as error:
        raise ConfigurationError(device, f"{path} cannot be read: {error.strerror}", "correct its name") from None
    if len(text) > FILE_LIMIT_BYTES:
        raise ConfigurationError(device, f"{path.name} is larger than {FILE_LIMIT_BYTES} bytes", mend)
    try:
        _refuse_unsafe(text.decode("utf-8"))
        tree = YAML(typ="rt").load(text)
    except (YAMLError, ValueError, TypeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        place = path.name if mark is None else f"{path.name}:{mark.line + 1}:{mark.column + 1}"
        reason = getattr(error, "problem", None) or str(error)
        raise ConfigurationError(device, f"{place}: {str(reason).strip().splitlines()[0]}", mend) from None
    if not isinstance(tree, CommentedMap):
        raise ConfigurationError(device, f"{path.name}:1:1: is no mapping of keys to values", mend)
    return tree


def _refuse_unsafe(text: str) -> None:
    depth = 0
    for event in YAML(typ="rt").parse(text):
        line = event.start_mark.line + 1
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None) is not None:
            raise ValueError(f"line {line}: anchors and aliases are not accepted")
        if getattr(event, "tag", None) is not None:
            raise ValueError(f"line {line}: tags are not accepted")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > DEPTH_LIMIT:
            raise ValueError(f"line {line}: nested deeper than {DEPTH_LIMIT} levels")


def _plain(node: Any) -> Any:
    # Exact built-in types: ruamel's own number and string classes would fail a strict model.
    if isinstance(node, CommentedMap):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        return tuple(_plain(value) for value in node)
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node


def _position(tree: CommentedMap, location: Location) -> tuple[int, int]:
    node: Any = tree
    line = column = 0
    for step in location:
        if isinstance(node, CommentedMap) and step in node:
            line, column = node.lc.key(step)
        elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
            line, column = node.lc.item(step)
        else:
            continue
        node = node[step]
    return line + 1, column + 1
