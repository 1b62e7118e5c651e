"""What all commands share: the application they are entered in, and where they write."""

from __future__ import annotations

import json
import sys
from typing import Any

import typer
from rich.console import Console

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Infrared phase-measuring deflectometry: the 3-D shape of mirror-like, also discontinuous, objects.",
)

# For people, beside what a command prints: warnings, progress, what was wrong.
notes = Console(stderr=True)


def say(text: str) -> None:
    """Print a line as it is, whatever is in it and however long it is."""
    Console(soft_wrap=True).print(text, highlight=False, markup=False)


def note(text: str, style: str | None = None) -> None:
    """Print a line for a person on standard error."""
    notes.print(text, style=style, highlight=False, markup=False, soft_wrap=True)


def print_json(content: Any) -> None:
    """Print one JSON value on standard output."""
    sys.stdout.write(json.dumps(content) + "\n")
