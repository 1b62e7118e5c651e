"""Runs a compiled, GIL-free kernel over bands of rows in two threads.

The result of a kernel must not depend on the band a row is in: then it does not depend on the threads either.
numba's own threading is avoided because its portable layer aborts when two Python threads enter it at once.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

THREADS = min(2, len(os.sched_getaffinity(0)))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS, thread_name_prefix="sims")


def over_rows(kernel: Callable[[int, int], object], rows: int) -> None:
    """Call `kernel(first, last)` such that the half-open bands cover `rows` rows."""
    bands = THREADS if rows >= 64 else 1
    edges = [rows * k // bands for k in range(bands + 1)]
    pending = [_pool().submit(kernel, edges[k], edges[k + 1]) for k in range(1, bands)]
    kernel(edges[0], edges[1])
    for future in pending:
        future.result()
