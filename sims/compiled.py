"""How this package compiles: cached on disk, free of the GIL, and never stale.

numba's own cache looks only at the file a function stands in: a kernel that calls another file's kernel would
go on running that one's old code after an update. Here a cached kernel is valid for one state of all the
files that hold kernels.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)


@cache
def _package_stamp() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        source = path.read_bytes()
        if b"from sims.compiled import" in source:
            digest.update(source)
    return digest.hexdigest()


class _OneState:
    """Names cache files after the state of the code, so that processes with different states share none."""

    _lineno: int

    def get_source_stamp(self) -> str:
        return _package_stamp()

    def get_disambiguator(self) -> str:
        return f"{self._lineno}-{_package_stamp()[:16]}"


class _UserProvided(_OneState, UserProvidedCacheLocator):  # type: ignore[misc]
    pass


class _InTree(_OneState, InTreeCacheLocator):  # type: ignore[misc]
    pass


class _UserWide(_OneState, UserWideCacheLocator):  # type: ignore[misc]
    pass


class _Impl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_UserProvided, _InTree, _UserWide)


class _Cache(FunctionCache):  # type: ignore[misc]
    _impl_class = _Impl


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function on its first call; `options` are those of `numba.njit`."""

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = njit(nogil=True, error_model="numpy", **options)(function)
        dispatcher._cache = _Cache(function)
        return dispatcher

    return compiled if function is None else compiled(function)


def inner_kernel(function: Callable[..., Any]) -> Any:
    """Compile a function that other kernels call for every pixel: it must not allocate.

    Without numba's run time it counts no references to the arrays it is handed: two threads that count the
    same ones all the time hold each other up (tracing was ten times slower).
    """
    return kernel(function, _nrt=False)
