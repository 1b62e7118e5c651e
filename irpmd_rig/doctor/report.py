"""What the doctor found, for people and for programs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.console import Console
from rich.text import Text


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong or missing, and what mends it."""

    what: str
    remedy: str


@dataclass(frozen=True, slots=True)
class DeviceReport:
    """What was found at one instrument.

    Attributes
    ----------
    found
        What it told about itself, by name.
    unverified
        What is assumed about it and was never checked on one, with how to check it.
    findings
        What is wrong with it; empty for one in order.
    """

    name: str
    kind: str
    driver: str
    state: str
    found: Mapping[str, str] = field(default_factory=dict)
    unverified: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """What was found at one rig; `findings` are those of the rig as a whole."""

    rig: str
    file: str
    simulated: bool = False
    devices: tuple[DeviceReport, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def clean(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings and not any(device.findings for device in self.devices)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"clean": self.clean, **asdict(self)}

    def print(self, console: Console) -> None:
        """Print it for a person."""
        kind = ", simulated" if self.simulated else ""
        line(console, f"{self.rig} ({self.file}{kind})", "bold")
        for device in self.devices:
            _print_device(device, console)
        if self.findings:
            line(console, "\nthis machine" if self.devices else "", "red")
            _print_findings(self.findings, console)
        count = len(self.findings) + sum(len(device.findings) for device in self.devices)
        line(
            console,
            "\neverything is in order" if self.clean else f"\n{count} to mend",
            "green" if self.clean else "red",
        )


def line(console: Console, text: str, style: str = "") -> None:
    """Print text as it is: commands in it can be copied."""
    console.print(Text(text), style=style or None, soft_wrap=True)


def _print_device(device: DeviceReport, console: Console) -> None:
    line(console, f"\n{device.name}: {device.state} ({device.driver})", "red" if device.findings else "green")
    for name, value in device.found.items():
        line(console, f"  {name}: {value}")
    for assumption in device.unverified:
        line(console, f"  unverified: {assumption}", "yellow")
    _print_findings(device.findings, console)


def _print_findings(findings: Iterable[Finding], console: Console) -> None:
    for finding in findings:
        line(console, f"  wrong: {finding.what}", "red")
        line(console, f"   mend: {finding.remedy}")
