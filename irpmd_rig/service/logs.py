"""Structured logs: one JSON object a line on standard error, with the run that it is about."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Callable
from typing import TextIO

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

_RUN = re.compile(r"\b\d{8}-\d{6}-[0-9a-f]{6}\b")
# What these say while a run is under way is about that run.
_OF_THE_RUN = ("irpmd_rig.acquisition", "irpmd_rig.processing", "irpmd_rig.store", "drivers")


def configure(active_run: Callable[[], str | None], stream: TextIO = sys.stderr, level: int = logging.INFO) -> None:
    """Let everything that the process logs be one JSON object a line.

    Parameters
    ----------
    active_run
        Tells the run under way.
    stream
        Where to.
    level
        What is logged at least.
    """
    before: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.add_log_level,
        structlog.stdlib.ExtraAdder(),
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        _with_run(active_run),
        structlog.processors.format_exc_info,
    ]
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=before,
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.JSONRenderer(ensure_ascii=True, default=str),
        ],
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(formatter)
    logging.basicConfig(level=level, handlers=[handler], force=True)
    # The client library of whoever shares the process tells every request.
    logging.getLogger("httpx").setLevel(logging.WARNING)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            structlog.stdlib.PositionalArgumentsFormatter(),
            *before,
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
    )


def _with_run(active_run: Callable[[], str | None]) -> Processor:
    def with_run(_: WrappedLogger, __: str, entry: EventDict) -> EventDict:
        # The same once more, with control characters.
        entry.pop("color_message", None)
        if "run_id" not in entry:
            named = _RUN.search(str(entry.get("event", "")))
            run_id = named[0] if named else None
            if run_id is None and str(entry.get("logger", "")).startswith(_OF_THE_RUN):
                run_id = active_run()
            if run_id is not None:
                entry["run_id"] = run_id
        return entry

    return with_run
