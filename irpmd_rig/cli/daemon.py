"""The daemon."""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Annotated

import typer

from irpmd_rig.cli.application import app, say


@app.command()
def serve(
    rig: Annotated[str, typer.Argument(help="Rig file, or the name of a shipped one: sim, sim-gcd, lab.example.")],
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Where to listen instead of what the rig file says; 0: free.")
    ] = None,
    until_stdin_closes: Annotated[
        bool, typer.Option("--until-stdin-closes", help="End with standard input: for programs that start it.")
    ] = False,
) -> None:
    """Own a rig and serve it over HTTP until Ctrl-C or SIGTERM; then LEDs are off and stages stopped.

    Prints one line when requests are answered: `ready URL`, or `broken URL` and what is wrong with the rig file, the
    simulated world or the store, which is then all that is answered. The token that requests carry is in the file
    `token` of the folder of the runs. The log goes to standard error.
    """
    from irpmd_rig.service.server import serve as serve_rig

    if until_stdin_closes:
        threading.Thread(target=_end_with_stdin, name="stdin", daemon=True).start()
    serve_rig(rig, port=port, tell=_tell)


def _tell(url: str, wrong: str | None) -> None:
    say(f"ready {url}" if wrong is None else f"broken {url} {wrong}")
    sys.stdout.flush()


def _end_with_stdin() -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
