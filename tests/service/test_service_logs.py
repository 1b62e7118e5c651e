"""Structured logs."""

import io
import json
import logging
from collections.abc import Iterator
from typing import Any

import pytest
import structlog

from irpmd_rig.service.logs import configure

RUN = "20261122-114437-97cdc1"
OTHER = "20261122-114438-000000"


@pytest.fixture
def log() -> Iterator[io.StringIO]:
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    stream = io.StringIO()
    root.handlers = []
    configure(lambda: RUN, stream)
    yield stream
    root.handlers, root.level = handlers, level
    structlog.reset_defaults()


def lines(log: io.StringIO) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.getvalue().splitlines()]


def test_one_object_a_line(log: io.StringIO) -> None:
    logging.getLogger("somewhere").warning("two\nlines of %s", "text", extra={"path": "/x"})
    structlog.get_logger("elsewhere").info("told", count=3)
    logging.getLogger("somewhere").debug("nobody wants to know")
    first, second = lines(log)
    assert (first["event"], first["level"], first["logger"], first["path"]) == (
        "two\nlines of text", "warning", "somewhere", "/x",
    )  # fmt: skip
    assert first["timestamp"].endswith("Z")
    assert (second["event"], second["count"], second["logger"]) == ("told", 3, "elsewhere")
    assert "run_id" not in first


def test_lines_name_their_run(log: io.StringIO) -> None:
    logging.getLogger("irpmd_rig.acquisition.rig").warning("the stage stalls")
    logging.getLogger("irpmd_rig.acquisition.runner").warning("run %s ends", OTHER)
    with structlog.contextvars.bound_contextvars(run_id=OTHER):
        logging.getLogger("irpmd_rig.service").info("request")
    assert [line["run_id"] for line in lines(log)] == [RUN, OTHER, OTHER]


def test_a_fault_is_logged_with_its_place(log: io.StringIO) -> None:
    try:
        raise ValueError("of this test")
    except ValueError:
        logging.getLogger("somewhere").exception("it went wrong")
    (line,) = lines(log)
    assert "ValueError: of this test" in line["exception"]
    assert "test_service_logs.py" in line["exception"]
