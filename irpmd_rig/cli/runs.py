"""Runs and the emergency stop."""

from __future__ import annotations

import getpass
import socket
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, cast

import typer

from irpmd_rig.cli.application import app, print_json, say
from irpmd_rig.cli.connection import OfRig, Token, Url, connect

if TYPE_CHECKING:
    from irpmd_rig.client import Client, Control

LEASE_S = 60.0


class Action(StrEnum):
    """What can be done to a run."""

    abort = "abort"
    pause = "pause"
    resume = "resume"
    answer = "answer"
    retry = "retry"
    activate = "activate"
    delete = "delete"


@app.command()
def runs(
    run: Annotated[str | None, typer.Argument(help="Id of a run; none: list them, newest first.")] = None,
    action: Annotated[Action | None, typer.Argument(help="What to do to it.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="Runs that are listed.")] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
    url: Url = None,
    token: Token = None,
    rig: OfRig = None,
) -> None:
    """List the daemon's runs, look at one, or act on it."""
    from irpmd_rig.cli.telling import everything, listing

    with connect(url, token, rig) as client:
        if run is None:
            found = client.runs(limit)
            if as_json:
                print_json([one.model_dump(mode="json") for one in found])
            else:
                listing(found)
            return
        if action is not None:
            _act(client, run, action)
        if action is Action.delete:
            return
        shown = client.run(run)
        if as_json:
            print_json(shown.model_dump(mode="json"))
        else:
            everything(shown)


def _act(client: Client, run: str, action: Action) -> None:
    if action is Action.delete:
        client.delete_run(run)
    elif action is Action.activate:
        make_active = client.activate_reference if client.run(run).kind == "reference" else client.activate_calibration
        make_active(run)
    else:
        with client.lease(f"{getpass.getuser()} at {socket.gethostname()}", LEASE_S):
            client.act(run, cast("Control", action.value))
        if action is Action.retry:
            client.resume_queue()


@app.command()
def stop(
    clear: Annotated[bool, typer.Option("--clear", help="Allow starting again after a stop.")] = False,
    url: Url = None,
    token: Token = None,
    rig: OfRig = None,
) -> None:
    """Stop everything now: LEDs off, stages stopped, the run ended; nothing starts until --clear.

    Exit status 1 if an instrument could not be stopped. Without a daemon: irpmd-rig safe RIG.
    """
    from irpmd_rig.cli.telling import stopped

    with connect(url, token, rig) as client:
        if clear:
            client.clear_stop()
            say("cleared; the queue stays held until it is resumed or a recipe is run")
            return
        devices = client.stop().devices
    for name, report in devices.items():
        say(stopped(name, report))
    raise typer.Exit(0 if all(report.outcome == "stopped" for report in devices.values()) else 1)
