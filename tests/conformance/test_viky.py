"""The camera driver on viky.cti: a GenTL producer of MVTec's that nobody here wrote, shipped in the genicam wheel.

It has no exposure, gain, region, trigger or temperature, announces no timestamps, and its frames are in colour.
"""

import collections
import importlib.util
import os
import signal
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError, DeviceLost, NotConnected, Refused, Unsupported
from drivers.registry import make
from drivers.values import CameraSettings, Region, StopAnswer


@pytest.fixture(scope="module")
def producer():
    found = importlib.util.find_spec("genicam")
    if found is None or importlib.util.find_spec("harvesters") is None:
        pytest.skip("harvesters and genicam are not installed: pip install 'irpmd-rig[camera]'")
    path = Path(found.origin).with_name("viky.cti")
    if not path.exists():
        pytest.skip(f"{path} is absent: pip install genicam==1.6.0")
    return str(path)


@pytest.fixture(scope="module")
def camera(producer):
    camera = make("camera", "harvesters", "viky", {"producer": producer, "serial_number": "1"})
    camera.open()
    yield camera
    camera.close()


@pytest.fixture(autouse=True)
def _stopped(camera):
    yield
    camera.stop()


def test_which_of_its_three_cameras_must_be_said(producer):
    with pytest.raises(ConfigurationError, match="3 cameras fit"):
        make("camera", "harvesters", "viky", {"producer": producer}).open()
    with pytest.raises(NotConnected, match="finds no camera"):
        make("camera", "harvesters", "viky", {"producer": producer, "model": "MQ042RG-CM"}).open()


def test_what_it_lacks_is_told(camera):
    found = camera.capabilities()
    assert (found.model, found.serial_number, found.sensor_size_px) == ("Viky", "1", (400, 400))
    assert found.triggers == ("free",)
    assert found.exposure_range_us is None
    assert found.gain_range_db is None
    assert not found.has_region
    assert not found.has_temperature


@pytest.mark.parametrize(("name", "shape"), [("RGBa8", (400, 400, 4)), ("Mono8", (400, 400))])
def test_its_frames_arrive(camera, name, shape):
    assert camera.configure(CameraSettings(pixel_format=name)).pixel_format == name
    camera.arm(5)
    frames = list(camera.frames(3))
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    for frame in frames:
        assert (frame.image.shape, frame.image.dtype, frame.bits) == (shape, np.uint8, 8)
        assert np.ptp(frame.image) > 0
        assert frame.timestamp_s is None
        assert frame.exposure_us is None
    for earlier, later in pairwise(frames):
        assert later.frame_id == earlier.frame_id + 1
        assert later.received_s > earlier.received_s


def test_its_frame_rate_is_set(camera):
    assert camera.configure(CameraSettings(frame_rate_hz=20.0)).frame_rate_hz == 20
    camera.arm(5)
    received_s = [frame.received_s for frame in camera.frames(3)]
    assert np.diff(received_s).mean() == pytest.approx(0.05, abs=0.02)
    with pytest.raises(Refused, match="give 1 to"):
        camera.configure(CameraSettings(frame_rate_hz=1e6))


@pytest.mark.parametrize(
    "settings",
    [
        CameraSettings(exposure_us=1000.0),
        CameraSettings(gain_db=1.0),
        CameraSettings(region=Region(0, 0, 100, 100)),
        CameraSettings(pixel_format="Mono10"),
        CameraSettings(trigger="software"),
        CameraSettings(trigger="hardware"),
    ],
)
def test_what_it_lacks_is_unsupported(camera, settings):
    with pytest.raises(Unsupported):
        camera.configure(settings)


def test_temperature_and_trigger_are_unsupported_or_refused(camera):
    with pytest.raises(Unsupported):
        camera.temperature_c()
    camera.configure(CameraSettings())
    camera.arm()
    with pytest.raises(Refused):
        camera.trigger()
    assert camera.stop() == StopAnswer(stopped=True)


def test_its_nodes_are_dumped(camera):
    found = camera.dump()
    assert b"RegisterDescription" in found.xml[:200]
    assert {"Width", "PixelFormat", "BouncingBallSize"} <= {node.name for node in found.nodes}
    (exposure,) = (node for node in found.nodes if node.name == "AcquisitionMode")
    assert (exposure.kind, exposure.access, exposure.value) == ("enumeration", "RO", "Continuous")


def test_it_works_again_after_its_process_was_killed(camera):
    camera.configure(CameraSettings(pixel_format="Mono8"))
    camera.arm()
    os.kill(camera.process_id, signal.SIGKILL)
    with pytest.raises(DeviceLost):
        collections.deque(camera.frames(3))
    camera.arm(1)
    assert camera.fetch(3).image.shape == (400, 400)


def test_two_of_them_at_once(producer, camera):
    other = make("camera", "harvesters", "viky2", {"producer": producer, "serial_number": "2"})
    other.open()
    for one in (camera, other):
        one.configure(CameraSettings(pixel_format="Mono8"))
        one.arm(2)
    assert [len(list(one.frames(3))) for one in (camera, other)] == [2, 2]
    other.close()
