"""Spreading rows of an image over threads; the compiled kernels release the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from irpmd_rig.core.arguments import whole_number


def over_rows(height: int, threads: int, work: Callable[[int, int], None]) -> None:
    """Call ``work(first, last)`` on consecutive blocks of rows, one block a thread.

    Raises
    ------
    MeasurementError
        If ``threads`` is no whole number of at least 1.
    """
    whole_number("threads", threads, least=1)
    edges = [height * k // threads for k in range(threads + 1)]
    if threads == 1:
        work(0, height)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
