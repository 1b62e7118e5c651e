"""Runs as a person reads them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from rich.console import Console
from rich.table import Table

from irpmd_rig.cli.application import note, say
from irpmd_rig.client import Client, DeviceStop, Run

LISTING_COLUMNS = 300


def summary(client: Client, run: Run) -> None:
    """Print how a run ended, and what it measured."""
    if run.state != "succeeded":
        note(f"run {run.id} {run.state}: {run.reason}: {run.detail}", style="red")
        return
    say(f"run {run.id} succeeded: {run.frames} frames, results {', '.join(run.results) or 'none'}")
    if run.kind in ("align", "characterise"):
        say(client.result(run.id)["words"])
    if run.kind == "measure":
        result = client.result(run.id)
        if result["without_steps"]:
            say(f"no steps: {result['without_steps']}")
            return
        table = Table("step", "measured (mm)", "sigma (um)", "nominal (mm)", "deviation (um)", title=run.name)
        for step in result["steps"]:
            table.add_row(
                step["name"],
                f"{step['measured_mm']:.4f}",
                _number(step["uncertainty_um"], ".1f"),
                _number(step["nominal_mm"], ".4f"),
                _number(step["deviation_um"], "+.1f"),
            )
        Console().print(table)


def listing(runs: Sequence[Run]) -> None:
    """Print a table of runs, a line each."""
    table = Table("run", "kind", "name", "state", "reason", "attempt", box=None, pad_edge=False)
    for column in table.columns:
        column.no_wrap = True
    for run in runs:
        state = run.state or "by hand"
        table.add_row(run.id, run.kind, run.name, state, run.reason or "", str(run.attempt))
    # A terminal that is too narrow breaks a long line itself; a pipe has no width.
    Console(width=max(Console().width, LISTING_COLUMNS)).print(table)


def everything(run: Run) -> None:
    """Print all that is known of one run."""
    say(f"{run.id}: {run.kind}, {run.name}")
    say(f"{run.state or 'written by hand'}, attempt {run.attempt}, since {_local(run.changed)}")
    if run.reason:
        say(f"{run.reason}: {run.detail}")
    if run.place is not None:
        say(f"place {run.place} in the queue")
    if run.asked:
        say(f"{run.asked} was asked for")
    if run.progress is not None:
        progress = run.progress
        say(f"{progress.frames_done} of {progress.frames} frames, {progress.stations_done} of {progress.stations} "
            f"stations; {progress.doing}")  # fmt: skip
    if run.prompt is not None:
        say(f"asks: {run.prompt.text} (until {_local(datetime.fromtimestamp(run.prompt.expires_s))})")
    if run.results:
        say(f"results: {', '.join(run.results)}")


def stopped(name: str, report: DeviceStop) -> str:
    """What stopping an instrument achieved, in a line."""
    if report.outcome == "stopped":
        return f"{name}: stopped"
    if report.outcome == "cannot_be_stopped":
        return f"{name}: cannot be stopped; it ends by itself within {report.ends_in_s:.1f} s"
    return f"{name}: not known: {report.error}"


def _local(time: datetime | None) -> str:
    return "" if time is None else f"{time.astimezone():%Y-%m-%d %H:%M:%S}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)
