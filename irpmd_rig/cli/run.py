"""A recipe carried out by the daemon, watched from a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from irpmd_rig.cli.application import app, note, print_json, say
from irpmd_rig.cli.connection import OfRig, Token, Url, connect

if TYPE_CHECKING:
    from pathlib import Path

    from irpmd_rig.client import Client, Run


@app.command()
def run(
    recipe: Annotated[str, typer.Argument(help="Recipe file, or the name of a shipped recipe.")],
    activate: Annotated[
        bool, typer.Option("--activate", help="Let measurements use it, if it is a calibration or reference.")
    ] = False,
    detach: Annotated[bool, typer.Option("--detach", help="Let it wait in the queue, and print its id.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on standard output.")] = False,
    url: Url = None,
    token: Token = None,
    rig: OfRig = None,
) -> None:
    """Carry a recipe out on the daemon's rig: exit status 0 if it succeeded, 1 if not.

    Questions to the operator are answered here. Ctrl-C asks before it aborts.
    """
    from irpmd_rig.cli.following import Following
    from irpmd_rig.cli.telling import summary
    from irpmd_rig.shipped import recipe_file

    file = recipe_file(recipe)
    with connect(url, token, rig) as client:
        submitted = _submitted(client, file)
        if detach:
            say(submitted.id)
            return
        note(f"run {submitted.id}")
        ended = Following(client, submitted).to_the_end()
        if ended is None:
            note(f"run {submitted.id} is left to the daemon; see it with: irpmd-rig runs {submitted.id}")
            raise typer.Exit(1)
        good = ended.state == "succeeded"
        if activate and good:
            _activate(client, ended)
        if as_json:
            print_json(ended.model_dump(mode="json"))
        else:
            summary(client, ended)
    raise typer.Exit(0 if good else 1)


def _submitted(client: Client, file: Path) -> Run:
    """Submit a recipe; what is wrong with it is told with the name of its file."""
    from irpmd_rig.client import ProblemError

    try:
        return client.submit(file)
    except ProblemError as error:
        wrong = error.extras.get("errors")
        if error.kind != "recipe-refused" or not isinstance(wrong, list):
            raise
        named = [{**one, "file": str(file)} for one in wrong]
        raise ProblemError({**vars(error), **error.extras, "errors": named}) from None


def _activate(client: Client, run: Run) -> None:
    if run.kind == "reference":
        client.activate_reference(run.id)
    else:
        client.activate_calibration(run.id)
