from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from service_world import Service, serving

from irpmd_rig.acquisition.control import WorldControl
from irpmd_rig.acquisition.daemon import RigDaemon
from tests.small_world import rig_file, until, world


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WorldControl]:
    with world(tmp_path_factory.mktemp("lab") / "world") as control:
        yield control


@pytest.fixture(scope="session")
def running(lab: WorldControl, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    root: Path = tmp_path_factory.mktemp("store")
    with RigDaemon(rig_file(lab.folder, root)) as daemon, serving(daemon) as service:
        yield service


@pytest.fixture
def service(running: Service) -> Iterator[Service]:
    """The service, at rest before and after."""
    yield running
    daemon = running.daemon
    lease = daemon.take_lease("the end of a test", 60.0, override=True)
    for run in daemon.runs():
        if run.state is None or not run.state.final:
            daemon.act(run.id, "abort", lease.id)
    daemon.queue_action("hold")
    daemon.clear_stop()
    daemon.release_lease(lease.id)
    until(lambda: daemon.rig_status().active_run is None)


@pytest.fixture
def client(service: Service) -> Iterator[httpx.Client]:
    with service.client() as client:
        yield client
