"""The record of a verification: who looked at which instrument when, and what each check came to."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from ruamel.yaml import YAML

from drivers.values import NodeMap

FORMAT = 1

Verdict = Literal["yes", "no", "skipped"]


@dataclass(frozen=True, slots=True)
class Check:
    """One check.

    Attributes
    ----------
    device, check
        At which instrument, and what was asked.
    answer
        yes: it is so. no: it is not. skipped: not looked at.
    shown
        What was shown or done, e.g. the frames in hex.
    values
        What was read off or comes out of it; units are in the names.
    remark
        In the words of the person.
    """

    device: str
    check: str
    answer: Verdict
    shown: tuple[str, ...] = ()
    values: dict[str, float | str] = field(default_factory=dict)
    remark: str = ""


@dataclass(slots=True)
class Record:
    """A verification as it comes together.

    Attributes
    ----------
    instruments
        Driver, model and serial number of each, by name.
    complete
        Whether the walk went to its end.
    """

    rig: str
    file: str
    simulated: bool
    who: str
    began: datetime
    instruments: dict[str, dict[str, str]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    complete: bool = False

    @property
    def passed(self) -> bool:
        """Whether it went to its end and nothing was found to be otherwise."""
        return self.complete and all(check.answer != "no" for check in self.checks)

    def write(self, path: Path) -> None:
        """Write it as YAML.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        yaml = YAML()
        yaml.default_flow_style = False
        text = io.StringIO()
        yaml.dump(self._plain(), text)
        path.write_text(text.getvalue(), encoding="utf-8")

    def _plain(self) -> dict[str, Any]:
        now = datetime.now(UTC)
        return {
            "irpmd_rig_verification": FORMAT,
            "rig": self.rig,
            "file": self.file,
            "simulated": self.simulated,
            "who": self.who,
            "began": self.began.isoformat(timespec="seconds"),
            "ended": now.isoformat(timespec="seconds"),
            "complete": self.complete,
            "instruments": self.instruments,
            "checks": [
                {
                    key: list(value) if isinstance(value, tuple) else value
                    for key, value in asdict(check).items()
                    if value
                }
                for check in self.checks
            ],
        }


def record_path(folder: Path, rig: str, began: datetime) -> Path:
    """Name of a record: the rig and the time, in UTC."""
    slug = re.sub(r"[^a-z0-9]+", "-", rig.lower()).strip("-") or "rig"
    return folder / f"verification-{slug}-{began:%Y%m%d-%H%M%S}.yaml"


def write_nodes(nodes: NodeMap, path: Path) -> tuple[Path, ...]:
    """Write a camera's nodes as CSV to `path`, and its description file beside it; returns what was written.

    Raises
    ------
    OSError
        A file cannot be written.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("name", "kind", "access", "value"))
        for node in nodes.nodes:
            writer.writerow((node.name, node.kind, node.access, "" if node.value is None else node.value))
    if nodes.xml is None:
        return (path,)
    description = path.with_suffix(".xml")
    # Some cameras tell it compressed; the bytes are kept as they are.
    if nodes.xml.startswith(b"PK"):
        description = path.with_suffix(".zip")
    description.write_bytes(nodes.xml)
    return path, description
