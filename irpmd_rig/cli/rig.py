"""A rig without its daemon: looked at, and made safe."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from irpmd_rig.cli.application import app, note, say

if TYPE_CHECKING:
    from irpmd_rig.acquisition.rig_file import RigFile
    from irpmd_rig.client import DeviceStop

    Devices = Mapping[str, DeviceStop]

RigName = Annotated[str, typer.Argument(help="Rig file, or the name of a shipped one: sim, sim-gcd, lab.example.")]


@app.command()
def doctor(
    rig: RigName,
    verify: Annotated[
        bool, typer.Option("--verify", help="Walk through the checks of a first contact, and keep a record.")
    ] = False,
    record: Annotated[
        Path | None, typer.Option(help="File of the record; named after rig and time by default.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
) -> None:
    """Open every instrument of a rig: what is there, what is unverified, what is missing, what mends it."""
    from rich.console import Console

    from irpmd_rig.doctor import doctor as look

    if verify and as_json:
        raise typer.BadParameter("--verify asks in the terminal: leave out --json")
    raise typer.Exit(look(rig, verify=verify, as_json=as_json, console=Console(), record=record))


@app.command()
def safe(rig: RigName) -> None:
    """Turn the LEDs off and stop the stages, with or without a daemon: exit status 0 if all are known to be safe."""
    from irpmd_rig.acquisition.rig_file import read_rig
    from irpmd_rig.cli.telling import stopped

    rig_file = read_rig(rig, deep=False)
    devices = _stopped_by_daemon(rig_file)
    if devices is None:
        devices = _stopped_here(rig_file)
    for name, report in devices.items():
        say(stopped(name, report))
    raise typer.Exit(0 if all(report.outcome == "stopped" for report in devices.values()) else 1)


def _stopped_by_daemon(rig_file: RigFile) -> Devices | None:
    """Let the rig's daemon stop everything; None: there is none that answers."""
    from irpmd_rig.cli.connection import address_of
    from irpmd_rig.client import Client, ClientError

    try:
        with Client(address_of(rig_file), rig_file.storage.root / "token") as client:
            # Briefly first: a daemon that hangs is not waited for.
            client.health()
            devices = client.stop().devices
    except ClientError:
        return None
    note("the daemon stopped everything; nothing starts until irpmd-rig stop --clear")
    return devices


def _stopped_here(rig_file: RigFile) -> Devices:
    """Open the instruments and stop them; nothing else of them moves."""
    from irpmd_rig.acquisition.events import EventLog
    from irpmd_rig.acquisition.rig import Rig
    from irpmd_rig.acquisition.safety import Safety
    from irpmd_rig.client import DeviceStop

    if rig_file.world is not None:
        served = _served(rig_file, rig_file.world)
        if served is None:
            say("no world of this simulated rig is running: there is nothing to make safe")
            return {}
        rig_file = served
    opened = Rig(rig_file)
    try:
        opened.open(find_zeros=False)
        reports = Safety(opened, EventLog()).make_safe()
    finally:
        opened.close()
    return {
        name: DeviceStop(
            outcome="stopped" if report.stopped else "unknown" if report.error else "cannot_be_stopped",
            ends_in_s=report.ends_in_s,
            error=report.error,
        )
        for name, report in reports.items()
    }


def _served(rig_file: RigFile, world: Path) -> RigFile | None:
    """Let a simulated rig use the world that runs, and start none; None: none runs."""
    from irpmd_rig.acquisition.control import WorldControl
    from irpmd_rig.acquisition.simulated import default_folder

    folder = rig_file.simulation.folder or default_folder(world)
    if not WorldControl(folder).answers():
        return None
    as_it_runs = dict.fromkeys(("time_scale", "replay", "seed", "size_px", "stages"))
    return rig_file.with_simulation(folder=folder, private=False, **as_it_runs)
