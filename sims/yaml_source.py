"""Reads a YAML file so that every complaint about it can name line and column; refuses what is unsafe."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, DocumentStartEvent

from sims.errors import WorldError

# A world has 7 kB and 800 events; the parser is so slow that many more would hold it up for seconds.
SIZE_LIMIT_BYTES = 64_000
EVENT_LIMIT = 5_000
DEPTH_LIMIT = 20
Location = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Source:
    """A file's content as plain dicts, tuples and scalars, with the positions it was read from."""

    name: str
    content: Any
    tree: Any

    def position(self, location: Location, *, of_key: bool = False) -> str:
        """`file:line:column` of the value at `location`, of its key, or of the nearest thing that exists."""
        node, line, column = self.tree, 0, 0
        for depth, step in enumerate(location):
            if isinstance(node, CommentedMap) and step in node:
                last = depth == len(location) - 1
                line, column = node.lc.key(step) if of_key and last else node.lc.value(step)
            elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
                line, column = node.lc.item(step)
            else:
                continue
            node = node[step]
        return f"{self.name}:{line + 1}:{column + 1}"

    def keys_at(self, location: Location) -> Location:
        """Keep the part of `location` that is in the file (validators add marks of their own)."""
        node, kept = self.tree, []
        for step in location:
            if (isinstance(node, CommentedMap) and step in node) or (
                isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node)
            ):
                node = node[step]
                kept.append(step)
        return tuple(kept)


def read(path: Path) -> Source:
    """Read one YAML document whose top level is a mapping.

    Raises
    ------
    WorldError
        It cannot be read, is too large, is no YAML, repeats a key, or uses aliases, anchors or tags.
    """
    text = _text(path)
    try:
        _refuse_unsafe(path.name, text)
        tree = YAML(typ="rt").load(text)
    except YAMLError as error:
        raise WorldError(f"{_place(path.name, error)}: {_reason(error)}") from None
    except (ValueError, TypeError, RecursionError) as error:
        if isinstance(error, WorldError):
            raise
        raise WorldError(f"{path.name}: a value cannot be read: {error}") from None
    if not isinstance(tree, CommentedMap):
        raise WorldError(f"{path.name}:1:1: the file must be a mapping of keys to values")
    return Source(path.name, _plain(tree), tree)


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            raw = file.read(SIZE_LIMIT_BYTES + 1)
    except OSError as error:
        raise WorldError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise WorldError(f"{str(path)!r}: is no path: {error}") from None
    if len(raw) > SIZE_LIMIT_BYTES:
        raise WorldError(f"{path.name}: is larger than {SIZE_LIMIT_BYTES} bytes")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise WorldError(f"{path.name}: is not UTF-8 text (byte {error.start})") from None


def _refuse_unsafe(name: str, text: str) -> None:
    depth = documents = 0
    for number, event in enumerate(YAML(typ="rt").parse(text)):
        mark = event.start_mark
        place = f"{name}:{mark.line + 1}:{mark.column + 1}"
        if number >= EVENT_LIMIT:
            raise WorldError(f"{place}: the file holds too many values")
        if isinstance(event, AliasEvent) or getattr(event, "anchor", None) is not None:
            raise WorldError(f"{place}: anchors and aliases are not accepted: write the value out")
        if getattr(event, "tag", None) is not None:
            raise WorldError(f"{place}: tags are not accepted: write a plain value")
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        documents += isinstance(event, DocumentStartEvent)
        if depth > DEPTH_LIMIT:
            raise WorldError(f"{place}: is nested deeper than {DEPTH_LIMIT} levels")
        if documents > 1:
            raise WorldError(f"{place}: the file must hold one document")


def _place(name: str, error: YAMLError) -> str:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    return name if mark is None else f"{name}:{mark.line + 1}:{mark.column + 1}"


def _reason(error: YAMLError) -> str:
    reason = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    return str(reason).strip().splitlines()[0]


def _plain(node: Any) -> Any:
    # Exact built-in types: the models validate strictly, and a sequence is a tuple there.
    if isinstance(node, CommentedMap):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        return tuple(_plain(value) for value in node)
    for kind in (bool, int, float, str):
        if isinstance(node, kind):
            return kind(node)
    return node
