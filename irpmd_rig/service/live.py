"""The live view: one producer of pictures for all who watch; whoever is slow misses some."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import TYPE_CHECKING

from irpmd_rig.service.pictures import preview

if TYPE_CHECKING:
    from irpmd_rig.service.desk import Desk

BOUNDARY = "irpmd-rig-frame"
# Between two pictures, so that other commands get their turn.
PAUSE_S = 0.03


class Live:
    """Lets any number of clients watch the camera; nothing is taken while nobody does.

    Parameters
    ----------
    desk
        Where the daemon and its threads are.
    """

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._show: _Show | None = None

    @property
    def watchers(self) -> int:
        """How many watch."""
        return 0 if self._show is None else len(self._show.watchers)

    async def watch(self, lease_id: str, limit: int | None) -> AsyncGenerator[bytes, None]:
        """Yield parts of a multipart answer, each a picture; ends with the lease, or when a run begins.

        Raises
        ------
        irpmd_rig.acquisition.errors.AcquisitionError, drivers.errors.InstrumentError, ProblemError
            There is no first picture, and why.
        """
        with self._desk.stream() as woken:
            show = self._joined(lease_id, woken)
            seen = sent = 0
            try:
                while not self._desk.closing and sent != limit:
                    await woken.wait()
                    woken.clear()
                    if show.number != seen:
                        seen, sent = show.number, sent + 1
                        yield _part(show.latest)
                    elif show.error is not None:
                        if not sent:
                            raise show.error
                        return
            finally:
                show.leave(woken)

    def _joined(self, lease_id: str, woken: asyncio.Event) -> _Show:
        if self._show is None or self._show.over or self._show.lease_id != lease_id:
            self._show = _Show(self._desk, lease_id)
        self._show.join(woken)
        return self._show


class _Show:
    """Takes pictures under one lease until it cannot, or nobody watches any more."""

    def __init__(self, desk: Desk, lease_id: str) -> None:
        self._desk = desk
        self.lease_id = lease_id
        self.watchers: set[asyncio.Event] = set()
        self.number = 0
        self.latest = b""
        self.error: Exception | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def over(self) -> bool:
        return self._task is not None and (self._task.done() or not self.watchers)

    def join(self, woken: asyncio.Event) -> None:
        self.watchers.add(woken)
        if self._task is None:
            self._task = asyncio.create_task(self._produce(), name="live view")

    def leave(self, woken: asyncio.Event) -> None:
        self.watchers.discard(woken)
        if not self.watchers and self._task is not None:
            self._task.cancel()

    async def _produce(self) -> None:
        try:
            while True:
                self.latest = await self._desk.commanding(self._picture)
                self.number += 1
                self._wake()
                await asyncio.sleep(PAUSE_S)
        # Whatever it is, those who watch are told or let go.
        except Exception as error:
            self.error = error
            self._wake()

    def _picture(self) -> bytes:
        self._desk.daemon.check_lease(self.lease_id)
        frame = self._desk.daemon.hand.camera_frame()
        return preview(frame.image, frame.bits)

    def _wake(self) -> None:
        for woken in self.watchers:
            woken.set()


def _part(picture: bytes) -> bytes:
    head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
    return head.encode() + picture + b"\r\n"
