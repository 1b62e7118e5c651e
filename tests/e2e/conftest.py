"""One simulated world for the whole session, and one daemon on it for what leaves the daemon alive."""

from collections.abc import Iterator

import pytest

from tests.campaigns import lab as labs
from tests.campaigns.lab import Daemon, Lab


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    with labs.lab(tmp_path_factory.mktemp("lab")) as lab:
        yield lab


@pytest.fixture(scope="module")
def running(lab: Lab) -> Iterator[Daemon]:
    with lab.daemon() as daemon:
        yield daemon


@pytest.fixture
def daemon(lab: Lab, running: Daemon) -> Iterator[Daemon]:
    """The daemon with everything in good order before and after."""
    yield running
    lab.mend()
    running.client.clear_stop()
    running.client.hold_queue()
    with running.lease():
        for run in running.client.runs():
            if run.state not in labs.FINAL:
                running.client.act(run.id, "abort")
    running.ready()
    lab.at_rest()
