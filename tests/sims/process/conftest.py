"""One running world, and the real drivers opened on it."""

import importlib.util
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from world_client import ServedWorld

SIZE_PX = 320
TIME_SCALE = 20


@pytest.fixture(scope="session", autouse=True)
def _genicam() -> None:
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed: pip install 'irpmd-rig[camera]'")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedWorld]:
    options = ("--size-px", str(SIZE_PX), "--time-scale", str(TIME_SCALE), "--seed", "5")
    with ServedWorld(tmp_path_factory.mktemp("world"), *options) as served:
        yield served


@pytest.fixture(scope="module")
def opened(world: ServedWorld) -> Iterator[SimpleNamespace]:
    """All instruments, open, with both axes homed."""
    devices = SimpleNamespace(
        camera=world.camera(),
        projector=world.projector(timeout_s=1.0),
        stage1=world.stage("stage1", progress_timeout_s=0.5),
        stage2=world.stage("stage2", progress_timeout_s=0.5),
    )
    try:
        for device in vars(devices).values():
            device.open()
        devices.stage1.home()
        devices.stage2.home()
        yield devices
    finally:
        for device in vars(devices).values():
            device.close()
