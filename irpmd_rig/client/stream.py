"""Server-sent events as they come off the wire, and where a reader goes on when the line breaks."""

from __future__ import annotations

import time

from pydantic import ValidationError

from irpmd_rig.client.errors import ClientError, ServiceUnreachable
from irpmd_rig.service.models import Event

# The service says something at least every 15 s, be it only that it is alive.
SILENCE_S = 45.0
PATIENCE_S = 60.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 5.0


class EventReader:
    """Cuts a stream into events; feed it whatever arrives.

    Of the event-stream format only `data` is looked at: the service writes an event as one line of JSON that holds
    everything, its id and kind too.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, piece: bytes) -> list[Event]:
        """Return the events that are complete with this piece.

        Raises
        ------
        ClientError
            It is not what the daemon sends.
        """
        # In bytes: a text may hold characters that count as ends of lines elsewhere.
        *lines, self._rest = (self._rest + piece).split(b"\n")
        try:
            return [Event.model_validate_json(line[5:]) for line in lines if line.startswith(b"data:")]
        except ValidationError as error:
            raise ClientError(f"an event cannot be read: {error}; are client and daemon of one version?") from None


class Place:
    """A reader's place in the stream, over any number of connections.

    Parameters
    ----------
    after
        Id of the last event that was seen; None: only what comes from now on.
    limit
        End after so many events; None: never.
    patience_s
        How long a daemon that does not answer is waited for.
    """

    def __init__(self, after: int | None = None, limit: int | None = None, patience_s: float = PATIENCE_S) -> None:
        self._after = after
        self._left = limit
        self._patience_s = patience_s
        self._lost_at_s: float | None = None
        self._pause_s = _FIRST_PAUSE_S
        self._reader = EventReader()

    def is_over(self) -> bool:
        """Whether all events that were asked for have come."""
        return self._left is not None and self._left <= 0

    @property
    def headers(self) -> dict[str, str]:
        """Headers of the next connection."""
        resumes = {} if self._after is None else {"Last-Event-ID": str(self._after)}
        return {"Accept": "text/event-stream", **resumes}

    def connected(self) -> None:
        """Take note that the daemon answers."""
        self._lost_at_s = None
        self._reader = EventReader()

    def take(self, piece: bytes) -> list[Event]:
        """Return the events that came; raises as `EventReader.feed`."""
        events = self._reader.feed(piece)[: self._left]
        # Whoever was connected for a while may try again at once.
        self._pause_s = _FIRST_PAUSE_S
        if events:
            self._after = events[-1].id
        if self._left is not None:
            self._left -= len(events)
        return events

    def pause_s(self, error: ServiceUnreachable | None = None) -> float:
        """How long to wait before the next connection; raises the error once patience is at its end."""
        now_s = time.monotonic()
        self._lost_at_s = now_s if self._lost_at_s is None else self._lost_at_s
        if error is not None and now_s - self._lost_at_s > self._patience_s:
            raise error
        pause_s, self._pause_s = self._pause_s, min(2 * self._pause_s, _LONGEST_PAUSE_S)
        return pause_s
