"""What a model refuses in a document, in words that a person can act on."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from irpmd_rig.recipes.yaml_values import Location


@dataclass(frozen=True, slots=True)
class Refusal:
    """One thing that a model refuses.

    Attributes
    ----------
    location : tuple
        Path of keys and indices to what is meant.
    at_key : bool
        Whether the key is wrong, not the value.
    what, remedy : str
        What is wrong, what to do.
    """

    location: Location
    at_key: bool
    what: str
    remedy: str


def refusals(
    values: Mapping[str, Any], model: type[BaseModel], error: ValidationError, blamed: Collection[Location]
) -> list[Refusal]:
    """Put what a model refuses into words: one refusal for each place, as the members of a union complain together.

    Parameters
    ----------
    values, model, error
        What was validated, against what, and what pydantic said.
    blamed
        Places about which something was said before.
    """
    grouped: dict[tuple[Location, bool], list[ErrorDetails]] = {}
    every = [(found, _written(values, found)) for found in error.errors(include_url=False)]
    wrong_inside = {written[:depth] for _, written in every for depth in range(len(written))}
    for found, written in every:
        told = any(written[:depth] in blamed for depth in range(len(written) + 1))
        if not told and not _follows(found, written in wrong_inside):
            grouped.setdefault((written, found["type"] == "extra_forbidden"), []).append(found)
    return [_refusal(model, location, found) for (location, _), found in grouped.items()]


def nearest(word: str, known: Iterable[str]) -> str:
    """Say what `word` may have meant: the nearest of the known names, and all of them."""
    names = sorted(known)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.5)
    listing = "known are: " + ", ".join(names) if names else "none are known"
    return f"did you mean {close[0]!r}? {listing}" if close else listing


def written_path(location: Location) -> str:
    """Write a path of keys and indices as people do: ``positions_mm[1]``."""
    path = ""
    for step in location:
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else step
    return path


def _refusal(model: type[BaseModel], location: Location, found: list[ErrorDetails]) -> Refusal:
    kind = found[0]["type"]
    path = written_path(location)
    if kind == "extra_forbidden":
        known = {key for one in found for key in _keys_at(model, one["loc"][:-1])}
        return Refusal(location, True, f"unknown key {path!r}", nearest(str(location[-1]), known))
    if kind in ("missing", "union_tag_not_found"):
        return Refusal(location[:-1], True, f"{path!r} is missing", f"add {location[-1]}")
    demands = list(dict.fromkeys(demand for one in found if (demand := _demand(one))))
    if len(demands) == len({(one["type"], one["msg"]) for one in found}):
        what = f"must be {' or '.join(demands)}" + _shown(found[0]["input"])
        remedy = " or ".join(dict.fromkeys(_REMEDIES.get(one["type"]) or f"give {_demand(one)}" for one in found))
        # Strict integers call 4.0 by the same name as text.
        if kind == "int_type" and isinstance(found[0]["input"], float):
            remedy = "write a whole number without a decimal point"
    else:
        what, remedy = _complaint(next((one for one in found if not _demand(one)), found[0]))
    return Refusal(location, False, f"{path!r} {what}" if path else what, remedy)


def _follows(found: ErrorDetails, wrong_inside: bool) -> bool:
    """Whether a complaint only repeats one about a part of the same value."""
    given = found["input"]
    if found["type"] == "too_short" and isinstance(given, tuple):
        # Parts that were refused are not counted.
        return len(given) >= int(found.get("ctx", {})["min_length"])
    # A mapping was meant, not the word that may stand in its place.
    return found["type"] == "literal_error" and isinstance(given, Mapping | tuple) and wrong_inside


def _written(values: Any, error: ErrorDetails) -> Location:
    """Path of what is meant in the document, without a validator's marks for the members of a union."""
    kept: list[str | int] = []
    context = error.get("ctx", {})
    steps: Location = (*error["loc"], *(context.get("at") or ()))
    if error["type"].startswith("union_tag"):
        steps = (*steps, str(context["discriminator"]).strip("'"))
    for depth, step in enumerate(steps):
        if (isinstance(values, Mapping) and step in values) or (
            isinstance(values, tuple) and isinstance(step, int) and 0 <= step < len(values)
        ):
            values = values[step]  # type: ignore[index]
            kept.append(step)
        elif depth == len(steps) - 1 and error["type"] in ("missing", "union_tag_not_found"):
            kept.append(step)
    return tuple(kept)


_MAPPING = "write keys and values below it"
_REMEDIES = {
    "int_type": "write a whole number without quotes",
    "float_type": "write a number without quotes or unit",
    "bool_type": "write true or false",
    "string_type": "write text; put numbers and words like true in quotes",
    "tuple_type": "write a list: [a, b]",
    "model_type": _MAPPING,
    "model_attributes_type": _MAPPING,
    "dict_type": _MAPPING,
}
_DEMANDS = {
    "int_type": "a whole number",
    "string_type": "text",
    "bool_type": "true or false",
    "tuple_type": "a list",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dict_type": "a mapping",
}


def _demand(error: ErrorDetails) -> str:
    """What a value must be, in words; empty if pydantic does not say."""
    if error["type"] in _DEMANDS:
        return _DEMANDS[error["type"]]
    message = error["msg"]
    starts = {
        "Input should be ": "",
        "String should have ": "text with ",
        "Tuple should have ": "a list of ",
        "Value should have ": "a list of ",
    }
    start = next((start for start in starts if message.startswith(start)), None)
    if start is None:
        return ""
    message = starts[start] + message.removeprefix(start).split(" after validation")[0]
    words = {"greater than or equal to": "at least", "less than or equal to": "at most", "greater than": "above"}
    for long, short in (words | {"less than": "below", "a valid ": "a "}).items():
        message = message.replace(long, short)
    return message


def _complaint(error: ErrorDetails) -> tuple[str, str]:
    """What is wrong and the remedy where pydantic does not say what a value must be."""
    context = error.get("ctx", {})
    if error["type"] == "complaint":
        return str(context["what"]), str(context["remedy"])
    if error["type"] == "union_tag_invalid":
        known = [tag.strip().strip("'") for tag in str(context["expected_tags"]).split(",")]
        return f"is unknown: {context['tag']!r}", nearest(str(context["tag"]), known)
    return f"is wrong: {error['msg'].removeprefix('Value error, ')}", "correct it"


def _shown(value: Any) -> str:
    if isinstance(value, Mapping | tuple):
        return ""
    if value is None:
        return "; it is empty"
    written = str(value).lower() if isinstance(value, bool) else repr(value)
    return f", not {written if len(written) <= 60 else written[:57] + '...'}"


def _keys_at(model: type[BaseModel], location: Location) -> set[str]:
    kinds: list[Any] = [model]
    for step in location:
        kinds = [found for kind in kinds for found in _descend(kind, step)] or kinds
    return {key for kind in kinds if _is_model(kind) for key in kind.model_fields}


def _descend(kind: Any, step: str | int) -> list[Any]:
    if not _is_model(kind):
        return [part for argument in get_args(kind) for part in _alternatives(argument)]
    if str(step) in kind.model_fields:
        return _alternatives(kind.model_fields[str(step)].annotation)
    # The mark of a member of a union: its name, or the value of the key that tells the members apart.
    literals = [get_args(field.annotation) for field in kind.model_fields.values() if _is_literal(field.annotation)]
    return [kind] if step == kind.__name__ or any(step in values for values in literals) else []


def _alternatives(annotation: Any) -> list[Any]:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _alternatives(get_args(annotation)[0])
    if origin in (Union, UnionType):
        return [part for argument in get_args(annotation) for part in _alternatives(argument)]
    return [annotation]


def _is_literal(annotation: Any) -> bool:
    return get_origin(annotation) is Literal


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
