"""Questions to the person in front of the rig, in the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable

from rich.console import Console
from rich.text import Text

from irpmd_rig.doctor.record import Verdict
from irpmd_rig.doctor.report import line

_VERDICTS: dict[str, Verdict] = {"y": "yes", "yes": "yes", "n": "no", "no": "no", "s": "skipped", "": "skipped"}

Read = Callable[[str], str]


class Asker:
    """Asks until it understands the answer; the end of the input is EOFError.

    Parameters
    ----------
    console
        Where questions and notes appear.
    read
        Takes a line of input after showing a prompt; None: from the console.
    """

    def __init__(self, console: Console, read: Read | None = None) -> None:
        self._console = console
        self._read: Read = read or (lambda prompt: console.input(Text(prompt)))

    def say(self, text: str, style: str = "") -> None:
        """Show a line."""
        line(self._console, text, style)

    def verdict(self, question: str) -> Verdict:
        """Ask what is so, is not so, or was not looked at."""
        while True:
            answer = self._read(f"{question} [y = yes, n = no, Enter = skip] ").strip().lower()
            if answer in _VERDICTS:
                return _VERDICTS[answer]
            self.say("Answer y or n, or press Enter to skip.")

    def agreed(self, question: str) -> bool:
        """Ask for a consent: only a written yes is one."""
        return self._read(f"{question} [type yes] ").strip().lower() == "yes"

    def number(self, question: str) -> float | None:
        """Ask for a number; None: it was not read."""
        while True:
            answer = self._read(f"{question} [number, Enter = not read] ").strip()
            if not answer:
                return None
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if math.isfinite(value):
                return value
            self.say("Give a number with a decimal point, or press Enter.")

    def text(self, question: str) -> str:
        """Ask for words; they may be none."""
        return self._read(f"{question} ").strip()
