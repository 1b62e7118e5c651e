"""How commands find the daemon."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from irpmd_rig.acquisition.rig_file import RigFile
    from irpmd_rig.client import Client

Url = Annotated[
    str | None,
    typer.Option("--url", help="Address of the daemon; none: --rig's, IRPMD_RIG_URL, or http://127.0.0.1:8321/api/v1."),
]
Token = Annotated[
    Path | None,
    typer.Option("--token", help="File with the daemon's token; none: --rig's, IRPMD_RIG_TOKEN, or data/token."),
]
OfRig = Annotated[
    str | None, typer.Option("--rig", help="Rig file, or shipped one, that tells the address and the token's place.")
]


def connect(url: str | None, token: Path | None, rig: str | None = None) -> Client:
    """Make a client for the daemon that the options name; nothing is sent yet.

    What the options do not tell the environment does, then the defaults.

    Raises
    ------
    TokenUnreadable
        The token's file cannot be read.
    FileNotFoundError, DocumentError
        There is no such rig file, or it is wrong.
    """
    from irpmd_rig.client import DEFAULT_TOKEN, Client

    if rig is not None:
        from irpmd_rig.acquisition.rig_file import read_rig

        rig_file = read_rig(rig, deep=False)
        url, token = url or address_of(rig_file), token or rig_file.storage.root / "token"
    return Client(url, token or Path(os.environ.get("IRPMD_RIG_TOKEN") or DEFAULT_TOKEN))


def address_of(rig_file: RigFile) -> str:
    """Tell where the daemon of a rig answers on this computer."""
    service = rig_file.service
    host = "127.0.0.1" if service.host in ("", "0.0.0.0", "::") else service.host
    return f"http://{f'[{host}]' if ':' in host else host}:{service.port}/api/v1"
