"""The line to the service: requests, answers that come piece by piece, and connections that break."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx

from irpmd_rig.client import _calls as calls
from irpmd_rig.client._calls import Call
from irpmd_rig.client.errors import ServiceUnreachable, checked
from irpmd_rig.client.files import Arriving
from irpmd_rig.client.settings import (
    TIMEOUT_S,
    http_settings,
    lease_header,
    request_settings,
    service_url,
    unreachable,
)
from irpmd_rig.client.stream import SILENCE_S, Place
from irpmd_rig.service.models import Event

Answer = TypeVar("Answer")


class Connection:
    """Sends calls, with the token and the lease.

    Parameters
    ----------
    url, token, timeout_s
        As `Client` takes them.
    """

    def __init__(
        self, url: str | None = None, token: str | Path | None = None, *, timeout_s: float = TIMEOUT_S
    ) -> None:
        self.url = service_url(url)
        self.lease_id: str | None = None
        self._timeout_s = timeout_s
        self._http = httpx.Client(**http_settings(self.url, token, timeout_s))

    def close(self) -> None:
        """Close the connections; a lease stays until it expires."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _send(self, call: Call[Answer]) -> Answer:
        try:
            response = self._http.request(**request_settings(call, self.lease_id, self._timeout_s))
        except httpx.HTTPError as error:
            raise ServiceUnreachable(self.url, unreachable(error)) from error
        return call.read(checked(response))

    @contextmanager
    def _stream(self, method: str, path: str, **settings: Any) -> Iterator[httpx.Response]:
        """Open an answer that is read while it comes."""
        headers = {**settings.pop("headers", {}), **lease_header(self.lease_id)}
        try:
            with self._http.stream(method, path, headers=headers, **settings) as response:
                if not response.is_success:
                    response.read()
                yield checked(response)
        except httpx.HTTPError as error:
            raise ServiceUnreachable(self.url, unreachable(error)) from error

    def _save(self, path: str, target: Path, name: str) -> Path:
        with Arriving(target, name) as file, self._stream("GET", path, timeout=calls.COMMAND_LIMIT_S) as response:
            for piece in response.iter_bytes():
                file.write(piece)
        return file.target

    def _follow(self, run_id: str | None, place: Place) -> Iterator[list[Event]]:
        """Yield the events of every piece that comes: none at the beginning of a connection, and with every ping."""
        path = calls.events_path(run_id)
        while not place.is_over():
            try:
                with self._stream("GET", path, headers=place.headers, timeout=SILENCE_S) as response:
                    place.connected()
                    yield []
                    for piece in response.iter_bytes():
                        yield place.take(piece)
                        if place.is_over():
                            return
            except ServiceUnreachable as error:
                pause_s = place.pause_s(error)
            else:
                pause_s = place.pause_s()
            time.sleep(pause_s)
