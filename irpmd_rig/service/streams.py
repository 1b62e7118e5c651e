"""Endless answers."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing
from typing import TypeVar

Item = TypeVar("Item")


async def begun(stream: AsyncGenerator[Item, None]) -> AsyncIterator[Item]:
    """Wait for the first item here, so that what is in the way of it is told as a problem; then give all."""
    first = await anext(stream, None)
    return _all(first, stream)


async def _all(first: Item | None, stream: AsyncGenerator[Item, None]) -> AsyncIterator[Item]:
    async with aclosing(stream):
        if first is None:
            return
        yield first
        async for item in stream:
            yield item
