"""A daemon on a small simulated rig, for all tests of the clients."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from irpmd_rig.client import Client
from irpmd_rig.demo.private_daemon import PrivateDaemon, SimulatedRig
from irpmd_rig.shipped import world_file

WORLD = SimulatedRig(world_file("misaligned"), seed=None, size_px=96, time_scale=20.0)


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the daemon."""
    return tmp_path_factory.mktemp("daemon")


@pytest.fixture(scope="session")
def served(place: Path) -> Iterator[Client]:
    with PrivateDaemon(WORLD, place) as client:
        yield client


@pytest.fixture
def rig(served: Client, place: Path) -> Iterator[Client]:
    """A client of its own, that leaves neither lease nor stop nor waiting runs behind."""
    with Client(served.url, place / "data" / "token") as client:
        yield client
    served.clear_stop()
    served.hold_queue()
    with served.lease("cleaner", 60.0, override=True):
        for run in served.runs():
            if run.state is not None and not run.state.final:
                served.act(run.id, "abort")
