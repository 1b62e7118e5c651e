"""From what the daemon raises to what the client is answered."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drivers.errors import (
    DeviceLost,
    FramesLost,
    IncompleteFrame,
    InstrumentError,
    LimitReached,
    MotionFailed,
    NotConnected,
    Refused,
    TimedOut,
    Unsupported,
)
from irpmd_rig.acquisition.book import ActionRefused, BadKey, KeyReused, RecipeRefused
from irpmd_rig.acquisition.errors import AcquisitionError, SimulationError
from irpmd_rig.acquisition.hands import RigBusy
from irpmd_rig.acquisition.intake import NoSuchRecipe
from irpmd_rig.acquisition.interlocks import NotReady
from irpmd_rig.acquisition.lease import BadLease, LeaseHeld, LeaseNeeded
from irpmd_rig.acquisition.safety import StopLatched
from irpmd_rig.recipes.document import DocumentError
from irpmd_rig.service.problems import Problem, ProblemError, errors_of
from irpmd_rig.store.errors import (
    DiskFull,
    ExportError,
    FileNotInRun,
    NotUsable,
    RunFolderError,
    RunInUse,
    RunNotFound,
    StoreError,
    TransitionRefused,
    WriteFailed,
)

_log = logging.getLogger(__name__)

# The first that fits: what is special stands before what is general.
_SLUGS: tuple[tuple[type[Exception], str], ...] = (
    (LeaseHeld, "lease-held"),
    (LeaseNeeded, "lease-needed"),
    (BadLease, "invalid"),
    (BadKey, "invalid"),
    (KeyReused, "key-reused"),
    (NoSuchRecipe, "no-such-recipe"),
    (RigBusy, "rig-busy"),
    (StopLatched, "stopped"),
    (NotReady, "not-ready"),
    (ActionRefused, "action-refused"),
    (SimulationError, "simulation-failed"),
    (AcquisitionError, "action-refused"),
    (RecipeRefused, "recipe-refused"),
    (DocumentError, "recipe-refused"),
    (RunNotFound, "no-such-run"),
    (FileNotInRun, "no-such-file"),
    (RunInUse, "run-in-use"),
    (NotUsable, "not-usable"),
    (TransitionRefused, "action-refused"),
    (ExportError, "nothing-to-export"),
    (DiskFull, "disk-full"),
    (WriteFailed, "write-failed"),
    (RunFolderError, "unreadable-run"),
    (StoreError, "unreadable-run"),
    (LimitReached, "limit"),
    (Unsupported, "unsupported"),
    (Refused, "instrument-refused"),
    (NotConnected, "device-lost"),
    (DeviceLost, "device-lost"),
    (TimedOut, "device-timeout"),
    (MotionFailed, "motion-failed"),
    (IncompleteFrame, "frames-lost"),
    (FramesLost, "frames-lost"),
    (InstrumentError, "device-fault"),
)
_ROOTS = (AcquisitionError, DocumentError, StoreError, InstrumentError)


def problem_of(error: Exception) -> Problem:
    """Turn an error of the daemon into the problem that a client is told."""
    slug = next(slug for kind, slug in _SLUGS if isinstance(error, kind))
    extras: dict[str, Any] = {}
    if isinstance(error, LeaseHeld):
        extras["holder"] = asdict(error.holder)
    elif isinstance(error, RigBusy):
        extras["run_id"] = error.run_id
    elif isinstance(error, DocumentError):
        extras["errors"] = [asdict(problem) for problem in error.problems]
        more = f" (and {len(error.problems) - 1} more)" if len(error.problems) > 1 else ""
        return Problem(slug, f"{error.problems[0]}{more}", extras)
    elif isinstance(error, InstrumentError):
        extras["device"] = error.device
    return Problem(slug, str(error), extras)


def add_handlers(app: FastAPI) -> None:
    """Let an application answer whatever goes wrong with a problem document."""
    for root in _ROOTS:
        app.add_exception_handler(root, _answer(problem_of))
    app.add_exception_handler(ProblemError, _answer(lambda error: error.problem))  # type: ignore[attr-defined]
    app.add_exception_handler(RequestValidationError, _answer(_invalid))
    app.add_exception_handler(HTTPException, _answer(_http))


def _answer(told: Callable[[Exception], Problem]) -> Callable[[Request, Exception], Any]:
    async def answer(request: Request, error: Exception) -> Response:
        return told(error).response(request.url.path)

    return answer


def _invalid(error: Exception) -> Problem:
    assert isinstance(error, RequestValidationError)
    found = error.errors()
    for one in found:
        if one["type"] == "json_invalid":
            place = one["loc"][-1]
            return Problem(
                "malformed-json", f"{one.get('ctx', {}).get('error', 'it is not JSON')} at character {place}"
            )
    errors = errors_of([(one["loc"], one["msg"]) for one in found])
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    place = ".".join(errors[0]["location"])
    return Problem("invalid", f"{place}: {errors[0]['message']}{more}", {"errors": errors})


def _http(error: Exception) -> Problem:
    """What the framework itself refuses."""
    assert isinstance(error, HTTPException)
    if error.status_code == 404:
        return Problem("not-found", "there is nothing at this address")
    if error.status_code == 405:
        return Problem("method-not-allowed", "this address does not take this method", headers=error.headers or {})
    return Problem("malformed-json", "the body cannot be read as JSON")


class Net:
    """ASGI middleware that answers a fault of the program with a problem, and logs where it happened."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        began = False

        async def noted(message: Message) -> None:
            nonlocal began
            began = True
            await send(message)

        try:
            await self._app(scope, receive, noted)
        except Exception as error:
            if began or scope["type"] != "http":
                raise
            _log.exception("a fault of the program")
            problem = Problem("fault", f"{type(error).__name__}: see the log")
            await problem.response(scope["path"])(scope, receive, send)
