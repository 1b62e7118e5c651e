"""How both clients reach the service, and what they make of what happens on the way."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

from irpmd_rig.client._calls import Call
from irpmd_rig.client.errors import ClientError, RunFailed, TokenUnreadable
from irpmd_rig.service.models import Event, Run

DEFAULT_URL = "http://127.0.0.1:8321/api/v1"
PREFIX = "/api/v1"
DEFAULT_TOKEN = Path("data") / "token"
TIMEOUT_S = 30.0


def service_url(url: str | None) -> str:
    """Complete the address of a service: ``http://127.0.0.1:8321``, as the daemon says it, is enough.

    None stands for the environment's ``IRPMD_RIG_URL``, or the default address.

    Raises
    ------
    ClientError
        It is none.
    """
    if url is None:
        url = os.environ.get("IRPMD_RIG_URL") or DEFAULT_URL
    try:
        known = httpx.URL(url)
    except httpx.InvalidURL as error:
        raise ClientError(f"{url!r} is no address: {error}; give one like {DEFAULT_URL}") from None
    if known.scheme not in ("http", "https") or not known.host:
        raise ClientError(f"{url!r} is no address; give one like {DEFAULT_URL}")
    return url.rstrip("/") if known.path.strip("/") else url.rstrip("/") + PREFIX


def http_settings(url: str, token: str | Path | None, timeout_s: float) -> dict[str, Any]:
    """Make what an HTTP client is made with.

    Parameters
    ----------
    url
        Address of the service.
    token
        The token, the file in which it is, or None: the file that the environment's ``IRPMD_RIG_TOKEN`` names, else the
        default file if it is there.
    timeout_s
        Bound of an answer.

    Raises
    ------
    TokenUnreadable
        The file is not there, or not for us.
    """
    if token is None:
        named = os.environ.get("IRPMD_RIG_TOKEN")
        token = Path(named) if named else DEFAULT_TOKEN if DEFAULT_TOKEN.exists() else ""
    if isinstance(token, Path):
        token = _read(token)
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    # Without the environment: its proxies are for the internet, and the token is not for them.
    return {"base_url": url, "headers": headers, "timeout": timeout_s, "trust_env": False}


def request_settings(call: Call[Any], lease_id: str | None, timeout_s: float) -> dict[str, Any]:
    """Make what a request is made of."""
    headers = dict(call.headers) | lease_header(lease_id)
    return {
        "method": call.method,
        "url": call.path,
        "json": call.body,
        "params": dict(call.params),
        "headers": headers,
        "timeout": max(timeout_s, call.timeout_s or 0.0),
    }


def lease_header(lease_id: str | None) -> dict[str, str]:
    """Tell the service of the lease that we hold."""
    return {} if lease_id is None else {"X-Lease": lease_id}


def unreachable(error: httpx.HTTPError) -> str:
    """Say what happened on the way."""
    return (
        f"no answer within its time ({type(error).__name__})"
        if isinstance(error, httpx.TimeoutException)
        else (str(error) or type(error).__name__)
    )


def array_of(content: bytes, name: str) -> NDArray[Any]:
    """Read an npy file.

    Raises
    ------
    ClientError
        It is none.
    """
    try:
        array: NDArray[Any] = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise ClientError(f"{name} is no array: {error}; take one whose name ends in .npy") from None
    return array


def succeeded(run: Run) -> Run:
    """Pass a run that succeeded; raises RunFailed."""
    if run.state != "succeeded":
        raise RunFailed(run)
    return run


def may_have_ended(events: Sequence[Event]) -> bool:
    """Whether to ask for the run's state: at the beginning, where it may have changed, and now and then to be sure."""
    return not events or any(event.kind in ("state", "gap") for event in events)


def has_ended(run: Run) -> bool:
    """Whether a run will do nothing more by itself."""
    return run.state is None or run.state.final


def _read(path: Path) -> str:
    remedy = "it is in the folder of the runs (storage.root), and for the user alone who runs the daemon"
    try:
        token = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        what = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise TokenUnreadable(f"the token {path} cannot be read: {what}; {remedy}") from None
    if not token:
        raise TokenUnreadable(f"the token {path} is empty; {remedy}")
    return token
