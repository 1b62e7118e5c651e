"""What can go wrong between a script and the rig's daemon."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx


class ClientError(Exception):
    """Base of the client's errors."""


class ServiceUnreachable(ClientError):
    """The daemon does not answer at this address, or no longer.

    Parameters
    ----------
    url
        The address.
    what
        What happened.
    """

    def __init__(self, url: str, what: str) -> None:
        super().__init__(
            f"no answer from {url}: {what}; start the daemon (irpmd-rig serve RIG), or give its address as it says it"
        )
        self.url = url


class TokenUnreadable(ClientError):
    """The file with the daemon's token is not there or holds none."""


class ProblemError(ClientError):
    """The daemon refuses: a problem document (RFC 9457).

    Attributes
    ----------
    type
        What kind of problem it is, the same in every version: ``/problems/lease-held``, say. The service has a page
        about it there.
    title, detail
        The kind in words; what happened this time and what to do.
    status
        Status of the answer.
    instance
        What was asked for.
    extras
        The other members: ``holder`` of a lease, ``errors`` of a recipe, ``reasons`` why nothing can start, ...
    """

    def __init__(self, document: Mapping[str, Any]) -> None:
        known = dict(document)
        self.type = str(known.pop("type", "about:blank"))
        self.title = str(known.pop("title", ""))
        self.status = int(known.pop("status", 0))
        self.detail = str(known.pop("detail", ""))
        self.instance = str(known.pop("instance", ""))
        self.extras = known
        super().__init__(self._text())

    @property
    def kind(self) -> str:
        """The end of the type: ``lease-held``, say."""
        return self.type.rpartition("/")[2]

    def _text(self) -> str:
        wrong = self.extras.get("errors")
        if isinstance(wrong, list) and wrong:
            return "\n".join(_line(one) for one in wrong)
        return f"{self.title}: {self.detail}" if self.detail else f"{self.title} (status {self.status})"


class RunFailed(ClientError):
    """A run that was waited for ended, but did not succeed.

    Attributes
    ----------
    run : Run
        As it ended: `state`, `reason` and `detail` say why.
    """

    def __init__(self, run: Any) -> None:
        super().__init__(f"run {run.id} {run.state}: {run.reason}: {run.detail}")
        self.run = run


class NotInTime(ClientError):
    """What was waited for did not happen within the given time."""


def checked(response: httpx.Response) -> httpx.Response:
    """Pass an answer whose body has been read and that is no problem; raises ProblemError."""
    if response.is_success:
        return response
    try:
        document = response.json()
    except ValueError:
        document = None
    if not isinstance(document, dict) or "type" not in document:
        # Something else than the daemon: a proxy, or another program at this port.
        document = {"title": response.reason_phrase, "detail": response.text[:200], "status": response.status_code}
    raise ProblemError({"status": response.status_code, **document})


def _line(wrong: Any) -> str:
    """One line about one thing that is wrong: in a recipe by its place in the file, in a request by its name."""
    if not isinstance(wrong, dict):
        return str(wrong)
    if "line" in wrong:
        return f"{wrong['file']}:{wrong['line']}:{wrong['column']}: {wrong['what']}; {wrong['remedy']}"
    return f"{'.'.join(map(str, wrong.get('location', ())))}: {wrong.get('message')}"
