"""What happens, as server-sent events."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncGenerator
from dataclasses import fields
from typing import Annotated

from fastapi import APIRouter, Header, Query
from sse_starlette import EventSourceResponse, ServerSentEvent

from irpmd_rig.acquisition.events import Event
from irpmd_rig.service.desk import Desk, TheDesk
from irpmd_rig.service.documented import RUN, problems, text
from irpmd_rig.service.streams import begun

router = APIRouter(tags=["events"])

PING_S = 15
# A reader that takes nothing for so long is let go.
SEND_LIMIT_S = 60.0

_STREAM = text("Events, each with its data as JSON", "text/event-stream")
LastEventId = Annotated[
    int | None,
    Header(alias="Last-Event-ID", ge=0, le=2**62, description="Go on after this event; what is missed is told."),
]
Limit = Annotated[int | None, Query(ge=1, description="End the stream after so many events.")]


@router.get("/events", response_class=EventSourceResponse, responses=_STREAM | problems("invalid"))
async def events(desk: TheDesk, after_id: LastEventId = None, limit: Limit = None) -> EventSourceResponse:
    """Everything that happens, from now on or again from after the last event that was seen."""
    return await _stream(desk, after_id, None, limit)


@router.get("/runs/{run_id}/events", response_class=EventSourceResponse, responses=_STREAM | problems(*RUN, "invalid"))
async def run_events(
    desk: TheDesk, run_id: str, after_id: LastEventId = None, limit: Limit = None
) -> EventSourceResponse:
    """What happens to one run."""
    await desk.listing(desk.daemon.store.run, run_id)
    return await _stream(desk, after_id, run_id, limit)


async def _stream(desk: Desk, after_id: int | None, run_id: str | None, limit: int | None) -> EventSourceResponse:
    # Subscribed before the answer begins: what happens after that is never missed.
    stream = await begun(_told(desk, after_id, run_id, limit))
    return EventSourceResponse(stream, ping=PING_S, send_timeout=SEND_LIMIT_S)


async def _told(
    desk: Desk, after_id: int | None, run_id: str | None, limit: int | None
) -> AsyncGenerator[ServerSentEvent, None]:
    loop = asyncio.get_running_loop()
    left = limit
    with desk.stream() as woken:

        def wake() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(woken.set)

        with desk.daemon.events.subscribe(after_id, run_id, wake) as subscription:
            yield ServerSentEvent(comment="from here on")
            while not desk.closing:
                woken.clear()
                found = subscription.take()
                if found is None:
                    return
                for event in found:
                    yield _sent(event)
                    left = None if left is None else left - 1
                    if left == 0:
                        return
                if not found:
                    await woken.wait()


def _sent(event: Event) -> ServerSentEvent:
    content = {field.name: getattr(event, field.name) for field in fields(event)} | {"data": dict(event.data)}
    return ServerSentEvent(json.dumps(content, default=str), event=event.kind, id=str(event.id))
