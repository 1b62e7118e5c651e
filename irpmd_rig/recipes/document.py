"""Documents that people write, read into models; everything that is wrong is told at once, with line and column."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from irpmd_rig.recipes.wording import nearest, refusals
from irpmd_rig.recipes.yaml_values import Location, Values, read_values

__all__ = [
    "Document",
    "DocumentError",
    "Location",
    "Problem",
    "Settings",
    "check_document",
    "complaint",
    "locate",
    "nearest",
    "parse_document",
    "problem_at",
    "read_document",
]

SIZE_LIMIT_BYTES = 100_000
PROBLEMS_LIMIT = 100

Model = TypeVar("Model", bound=BaseModel)


class Settings(BaseModel):
    """Base of models for documents: frozen, exact types, finite numbers, unknown keys refused; sequences are tuples."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """One thing that is wrong in a document.

    Attributes
    ----------
    file : str
        Name of the document.
    line, column : int
        Where, both from 1.
    what, remedy : str
        What is wrong, what to do.
    """

    file: str
    line: int
    column: int
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}: {self.what}; {self.remedy}"


class DocumentError(ValueError):
    """A document that cannot be used.

    Attributes
    ----------
    problems : tuple of Problem
        All that is wrong, in the document's order; at least one.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(set(problems)))
        super().__init__("\n".join(str(problem) for problem in self.problems))


@dataclass(frozen=True, slots=True)
class Document:
    """A document as read: plain values and their places.

    Attributes
    ----------
    name : str
        What problems call it.
    text : str
        As written.
    values : dict
        Text keys; values are text, numbers, booleans, None, tuples and such dicts.
    problems : tuple of Problem
        What the reader refused; `check_document` raises them together with what the model refuses.
    """

    name: str
    text: str
    values: dict[str, Any]
    problems: tuple[Problem, ...]
    _read: Values = field(repr=False)

    def refused(self, location: Location) -> bool:
        """Whether the reader refused the value at a path, so that None stands there; `problems` says why."""
        return location in self._read.blamed


def read_document(source: str | Path, model: type[Model], name: str | None = None) -> Model:
    """Read a YAML document into a model.

    Parameters
    ----------
    source
        The text itself, or the path of a file.
    model
        What it must fit.
    name
        What problems call it; a file's path if not given.

    Raises
    ------
    DocumentError
        All that is wrong, each with line, column and remedy.
    """
    return check_document(parse_document(source, name), model)


def parse_document(source: str | Path, name: str | None = None) -> Document:
    """Read a YAML mapping of plain values.

    At most 100 kB of UTF-8 and 12 levels; no anchors, aliases, merge keys, tags, directives or duplicate keys. What is
    refused in a document that can be read further is in `Document.problems`.

    Raises
    ------
    DocumentError
        It cannot be read at all, or is no mapping.
    """
    name = name or (str(source) if isinstance(source, Path) else "text")
    text = _text(source, name)
    read = read_values(text)
    problems = tuple(Problem(name, *found.place, found.what, found.remedy) for found in read.complaints)
    if isinstance(read.tree, dict):
        return Document(name, text, read.tree, problems, read)
    if problems:
        raise DocumentError(problems)
    what = "is empty" if read.tree is None else "is no mapping of keys to values"
    raise DocumentError([Problem(name, *read.places.get((), (1, 1)), what, "give 'key: value' lines")])


def check_document(document: Document, model: type[Model]) -> Model:
    """Validate a document's values against a model.

    Raises
    ------
    DocumentError
        What the reader refused and what the model refuses.
    """
    problems = list(document.problems)
    try:
        checked = model.model_validate(document.values)
    except ValidationError as error:
        for refusal in refusals(document.values, model, error, document._read.blamed):
            key_place = document._read.key_places.get(refusal.location) if refusal.at_key else None
            place = key_place or locate(document, refusal.location)
            problems.append(Problem(document.name, *place, refusal.what, refusal.remedy))
    if problems:
        raise DocumentError(_bounded(problems))
    return checked


def locate(document: Document, location: Location) -> tuple[int, int]:
    """Line and column, both from 1, of the value at a path of keys and indices, or of the nearest value above it."""
    places = document._read.places
    while location not in places and location:
        location = location[:-1]
    return places.get(location, (1, 1))


def problem_at(document: Document, location: Location, what: str, remedy: str) -> Problem:
    """Make a problem about the value at a path of keys and indices."""
    return Problem(document.name, *locate(document, location), what, remedy)


def complaint(what: str, remedy: str, at: Location = ()) -> PydanticCustomError:
    """Make what a model's validator raises: says what is wrong, what to do, and where below the validated value."""
    return PydanticCustomError("complaint", "{what}", {"what": what, "remedy": remedy, "at": at})


def _text(source: str | Path, name: str) -> str:
    content = _content(source, name) if isinstance(source, Path) else source.encode("utf-8", "surrogatepass")
    if len(content) > SIZE_LIMIT_BYTES:
        raise DocumentError([Problem(name, 1, 1, f"is larger than {SIZE_LIMIT_BYTES} bytes", "make it smaller")])
    if isinstance(source, str):
        return source
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        before = content[: error.start]
        line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        what = f"byte 0x{content[error.start]:02X} is not UTF-8"
        raise DocumentError([Problem(name, line, column, what, "save the file as UTF-8")]) from None


def _content(path: Path, name: str) -> bytes:
    try:
        # Anything else, a named pipe say, could block for ever.
        if path.exists() and not path.is_file():
            raise DocumentError([Problem(name, 1, 1, "is no file", "give the path of a file")])
        with path.open("rb") as file:
            return file.read(SIZE_LIMIT_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, DocumentError):
            raise
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise DocumentError([Problem(name, 1, 1, f"cannot be read: {reason}", "correct the path")]) from None


def _bounded(problems: list[Problem]) -> list[Problem]:
    ordered = sorted(set(problems))
    if len(ordered) <= PROBLEMS_LIMIT:
        return ordered
    last = ordered[PROBLEMS_LIMIT - 1]
    left = len(ordered) - PROBLEMS_LIMIT + 1
    more = Problem(last.file, last.line, last.column, f"{left} further problems are not listed", "correct these first")
    return [*ordered[: PROBLEMS_LIMIT - 1], more]
