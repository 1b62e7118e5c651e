"""Plain values out of YAML text, with the line and column of each; only what two readers cannot read differently."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentStartEvent,
    Event,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
)

DEPTH_LIMIT = 12
_DIGITS_LIMIT = 40

Location = tuple[str | int, ...]
Place = tuple[int, int]

_INTEGER = re.compile(r"[-+]?[0-9]+")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]+")
_BASED = re.compile(r"0x[0-9a-fA-F]+|0o[0-7]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS: dict[str, bool | None] = {"": None, "~": None}
for _word, _value in (("null", None), ("true", True), ("false", False)):
    _WORDS |= {_word: _value, _word.capitalize(): _value, _word.upper(): _value}
# Line feed and tab are text; other control characters would reach terminals, file names and logs.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


@dataclass(frozen=True, slots=True)
class Complaint:
    """What is wrong at a place of the text.

    Attributes
    ----------
    place : tuple of int
        Line and column, both from 1.
    what, remedy : str
        What is wrong, what to do.
    """

    place: Place
    what: str
    remedy: str


@dataclass(slots=True)
class Values:
    """What a text holds, and where.

    Attributes
    ----------
    tree : object
        Dicts with text keys, tuples, text, numbers, booleans and None; None if there is no document.
    places, key_places : dict
        Line and column of each value and of each key, by the path to it.
    complaints : list of Complaint
        What was refused.
    blamed : set of location
        Values that were refused: None stands in their place.
    """

    tree: Any = None
    places: dict[Location, Place] = field(default_factory=dict)
    key_places: dict[Location, Place] = field(default_factory=dict)
    complaints: list[Complaint] = field(default_factory=list)
    blamed: set[Location] = field(default_factory=set)


def read_values(text: str) -> Values:
    """Read one YAML document of plain values; never raises: what is wrong is in `complaints`.

    Refused are duplicate keys, aliases, anchors, merge keys, tags, directives, several documents, numbers that are not
    finite or begin with 0, and nesting deeper than 12 levels. Scalars follow the core schema of YAML 1.2, so that
    ``no`` and ``1:30`` are text.
    """
    builder = _Builder()
    try:
        for event in _events(text):
            if not builder.take(event):
                break
    except YAMLError as error:
        builder.values.complaints.append(_syntax(error, text))
    except Exception as error:
        # The scanner lets plain ValueErrors and IndexErrors through, e.g. on an escape beyond Unicode.
        builder.complain(builder.last_place, f"cannot be read: {error}", "give a YAML file of plain keys and values")
    return builder.values


def _events(text: str) -> Iterator[Event]:
    # Pure Python for its exact marks; "safe" because the round-trip scanner adds comments, which nobody needs here.
    events: Iterator[Event] = YAML(typ="safe", pure=True).parse(text)
    return events


@dataclass(slots=True)
class _Level:
    """A mapping or sequence that is being read; `location` is None inside a part that is thrown away."""

    content: dict[str, Any] | list[Any]
    location: Location | None
    awaits_key: bool = True
    key: str | None = None
    is_key: bool = False


class _Builder:
    def __init__(self) -> None:
        self.values = Values()
        self.last_place: Place = (1, 1)
        self._levels: list[_Level] = []
        self._documents = 0

    def complain(self, place: Place, what: str, remedy: str, location: Location | None = None) -> None:
        self.values.complaints.append(Complaint(place, what, remedy))
        if location is not None:
            self.values.blamed.add(location)

    def take(self, event: Event) -> bool:
        """Take one event; False if reading further makes no sense."""
        mark = event.start_mark
        self.last_place = place = (mark.line + 1, mark.column + 1)
        if isinstance(event, DocumentStartEvent):
            return self._start_document(event, place)
        if isinstance(event, CollectionEndEvent):
            self._end()
        elif isinstance(event, NodeEvent):
            return self._node(event, place)
        return True

    def _start_document(self, event: DocumentStartEvent, place: Place) -> bool:
        self._documents += 1
        if self._documents > 1:
            self.complain(place, "a second document begins here", "give one document a file: leave out '---'")
            return False
        if event.version is not None or event.tags:
            self.complain(place, "directives (%YAML, %TAG) are not accepted", "leave them out")
        return True

    def _node(self, event: NodeEvent, place: Place) -> bool:
        level = self._levels[-1] if self._levels else None
        if level is not None and isinstance(level.content, dict) and level.awaits_key:
            return self._key(event, place, level)
        location = self._next_location(level)
        if location is not None:
            self.values.places[location] = place
        self._refuse_marks(event, place, location)
        if isinstance(event, AliasEvent):
            self._put(None)
        elif isinstance(event, ScalarEvent):
            self._put(self._scalar(event, place, location))
        else:
            return self._push({} if isinstance(event, MappingStartEvent) else [], location, place)
        return True

    def _key(self, event: NodeEvent, place: Place, level: _Level) -> bool:
        level.awaits_key, level.key = False, None
        self._refuse_marks(event, place, None)
        if not isinstance(event, ScalarEvent):
            self.complain(place, "a key is no plain text", "write keys as plain words")
            return isinstance(event, AliasEvent) or self._push([], None, place, is_key=True)
        plain = not event.style
        if plain and event.value == "<<":
            self.complain(place, "merge keys (<<) are not accepted", "write the values out")
        elif plain and event.value in _WORDS and _WORDS[event.value] is None:
            self.complain(place, "a key is missing", "write a key before the colon")
        elif _CONTROL.search(event.value):
            self.complain(place, f"the key {event.value!r} holds a control character", "write keys as plain words")
        elif event.value in level.content:
            self.complain(place, f"the key {event.value!r} is there twice", "leave one of them out")
        else:
            level.key = event.value
            if level.location is not None:
                self.values.key_places[(*level.location, event.value)] = place
        return True

    def _refuse_marks(self, event: NodeEvent, place: Place, location: Location | None) -> None:
        if isinstance(event, AliasEvent) or event.anchor is not None:
            self.complain(place, "anchors and aliases (&, *) are not accepted", "write the value out", location)
        elif getattr(event, "tag", None) is not None:
            self.complain(place, "tags (!) are not accepted", "write the plain value", location)

    def _next_location(self, level: _Level | None) -> Location | None:
        if level is None:
            return ()
        if level.location is None:
            return None
        if isinstance(level.content, list):
            return (*level.location, len(level.content))
        return None if level.key is None else (*level.location, level.key)

    def _push(
        self, content: dict[str, Any] | list[Any], location: Location | None, place: Place, is_key: bool = False
    ) -> bool:
        self._levels.append(_Level(content, location, is_key=is_key))
        if len(self._levels) <= DEPTH_LIMIT:
            return True
        self.complain(place, f"nested deeper than {DEPTH_LIMIT} levels", "give fewer levels", location)
        return False

    def _end(self) -> None:
        level = self._levels.pop()
        if not level.is_key:
            self._put(tuple(level.content) if isinstance(level.content, list) else level.content)

    def _put(self, value: Any) -> None:
        if not self._levels:
            self.values.tree = value
            return
        level = self._levels[-1]
        if isinstance(level.content, list):
            level.content.append(value)
            return
        if level.key is not None:
            level.content[level.key] = value
        level.awaits_key = True

    def _scalar(self, event: ScalarEvent, place: Place, location: Location | None) -> Any:
        text: str = event.value
        if found := _CONTROL.search(text):
            self.complain(place, f"the text holds the control character {found[0]!r}", "leave it out", location)
            return None
        if event.style:
            return text
        if text in _WORDS:
            return _WORDS[text]
        try:
            return _number(text)
        except ValueError as error:
            what, remedy = error.args
            self.complain(place, what, remedy, location)
            return None


def _number(text: str) -> int | float | str:
    """Value of a plain scalar: a number, or the text itself.

    Raises
    ------
    ValueError
        A number that is not accepted; its arguments are what is wrong and the remedy.
    """
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"{text} is no finite number", "give a number")
    if _BASED.fullmatch(text) and len(text) <= _DIGITS_LIMIT:
        return int(text, 0)
    if not _FLOAT.fullmatch(text):
        return text
    if len(text) > _DIGITS_LIMIT:
        raise ValueError(f"a number of {len(text)} digits", f"give at most {_DIGITS_LIMIT} digits, or put it in quotes")
    if _LEADING_ZERO.fullmatch(text):
        raise ValueError(f"{text} begins with 0, which some readers take as octal", f"write {int(text)}")
    if _INTEGER.fullmatch(text):
        return int(text)
    if math.isinf(value := float(text)):
        raise ValueError(f"{text} is too large for a number", "give a smaller number")
    return value


def _syntax(error: YAMLError, text: str) -> Complaint:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    position = getattr(error, "position", None)
    if mark is None and position is not None:
        before = text[:position]
        place = (before.count("\n") + 1, position - before.rfind("\n"))
        return Complaint(place, f"the character {text[position : position + 1]!r} is not accepted", "leave it out")
    place = (1, 1) if mark is None else (mark.line + 1, mark.column + 1)
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if "\\t" in reason:
        return Complaint(place, "a tab stands where YAML takes none", "indent and align with spaces")
    what = str(reason).strip().splitlines()[0]
    return Complaint(place, f"is no YAML: {what}", "check indentation, quotes and brackets before this place")
