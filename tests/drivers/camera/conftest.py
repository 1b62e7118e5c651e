"""A simulated camera and the driver on it."""

import importlib.util
import itertools
from collections.abc import Iterator

import pytest
from camera_rig import Rig


@pytest.fixture(scope="session", autouse=True)
def _genicam():
    if importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters is not installed: pip install 'irpmd-rig[camera]'")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return (tmp_path_factory.mktemp("camera") for _ in itertools.count())


@pytest.fixture(scope="module")
def rig(folders) -> Iterator[Rig]:
    rig = Rig(next(folders))
    yield rig
    rig.close()


@pytest.fixture
def other_rig(folders):
    """Make rigs with cameras of other kinds."""
    made = []

    def make(**twin):
        made.append(Rig(next(folders), **twin))
        return made[-1]

    yield make
    for rig in made:
        rig.close()


@pytest.fixture(scope="module")
def opened(rig):
    camera = rig.camera()
    camera.open()
    yield camera
    camera.close()


@pytest.fixture
def camera(opened):
    """Return an opened camera in good order, with short exposures."""
    yield opened
    opened.stop()
