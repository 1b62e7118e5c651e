"""What all handlers share: the daemon, threads to ask it in, and what ends with the service."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, ParamSpec, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import Depends, Header, Request

from irpmd_rig.acquisition.daemon import RigDaemon
from irpmd_rig.acquisition.lease import Lease
from irpmd_rig.service.live import Live
from irpmd_rig.service.metrics import Figures
from irpmd_rig.service.problems import Problem, ProblemError
from irpmd_rig.service.settings import ServiceSettings

if TYPE_CHECKING:
    from collections.abc import Iterator

Given = ParamSpec("Given")
Result = TypeVar("Result")

STREAM_LIMIT = 32


class Pool:
    """A few threads for one kind of calls, so that none keeps another kind waiting.

    Parameters
    ----------
    threads
        Calls at the same time.
    waiting
        Calls that may wait for a thread; more are refused.
    """

    def __init__(self, threads: int, waiting: int = 64) -> None:
        self._limiter = CapacityLimiter(threads)
        self._limit = threads + waiting
        self._calls = 0

    async def __call__(self, call: Callable[Given, Result], *args: Given.args, **kwargs: Given.kwargs) -> Result:
        """Call in a thread.

        Raises
        ------
        ProblemError
            too-busy.
        """
        if self._calls >= self._limit:
            raise ProblemError(Problem("too-busy", "too many requests of this kind wait", headers={"Retry-After": "1"}))
        self._calls += 1
        try:
            # Left to itself when the service ends: an instrument may be at it, and the daemon stops that one.
            asked = partial(call, *args, **kwargs)
            return await to_thread.run_sync(asked, abandon_on_cancel=True, limiter=self._limiter)
        finally:
            self._calls -= 1


class Desk:
    """Where the handlers find the daemon.

    Attributes
    ----------
    asking
        Threads for questions, which the daemon answers at once.
    listing
        Threads for questions about runs, which may wait while one is taken in.
    commanding
        Threads for commands to instruments and runs.
    stopping
        Threads for stops alone: there is always one.
    reading
        Threads for recipes: a hostile one takes seconds.
    filing
        Threads for files, pictures and exports.
    live
        The live view.
    figures
        What is counted.
    """

    def __init__(self, daemon: RigDaemon, settings: ServiceSettings) -> None:
        self.daemon = daemon
        self.settings = settings
        self.asking = Pool(8)
        self.listing = Pool(4)
        self.commanding = Pool(8, waiting=16)
        self.stopping = Pool(4)
        self.reading = Pool(2)
        self.filing = Pool(4)
        self.live = Live(self)
        self.figures = Figures()
        self.figures.watch(self)
        self._streams: set[asyncio.Event] = set()
        self._closing = False

    @contextmanager
    def stream(self) -> Iterator[asyncio.Event]:
        """Count an endless answer; yields an event that is set when there is something new, or the service ends.

        Raises
        ------
        ProblemError
            too-busy.
        """
        if len(self._streams) >= STREAM_LIMIT:
            raise ProblemError(Problem("too-busy", f"{STREAM_LIMIT} streams are open", headers={"Retry-After": "5"}))
        woken = asyncio.Event()
        self._streams.add(woken)
        try:
            yield woken
        finally:
            self._streams.discard(woken)

    @property
    def streams(self) -> int:
        """How many endless answers there are."""
        return len(self._streams)

    @property
    def closing(self) -> bool:
        """Whether the service ends: endless answers have to."""
        return self._closing

    def close(self) -> None:
        """Let endless answers end."""
        self._closing = True
        for woken in self._streams:
            woken.set()


def desk_of(request: Request) -> Desk:
    """Find the desk of the application that a request came to."""
    desk: Desk = request.app.state.desk
    return desk


TheDesk = Annotated[Desk, Depends(desk_of)]
LeaseId = Annotated[
    str | None, Header(alias="X-Lease", description="Id of the lease of whoever commands: see `POST /lease`.")
]


async def held_lease(desk: TheDesk, lease_id: LeaseId = None) -> Lease:
    """Let a command through whose sender holds the lease; raises LeaseHeld or LeaseNeeded."""
    return await desk.asking(desk.daemon.check_lease, lease_id)


HeldLease = Annotated[Lease, Depends(held_lease)]
