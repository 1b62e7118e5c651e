"""The camera driver through Aravis on its own fake GigE Vision camera, over loopback: nobody here wrote either."""

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import time
from collections import Counter, deque
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError, DeviceLost, IncompleteFrame, NotConnected, Refused, TimedOut, Unsupported
from drivers.registry import make
from drivers.values import CameraSettings, Region

FAKE = "arv-fake-gv-camera-0.8"
ADDRESS = "127.0.0.1"
SMALL = Region(0, 0, 128, 128)
FAST = CameraSettings(exposure_us=1000.0, pixel_format="Mono8", region=SMALL, frame_rate_hz=50.0)


@pytest.fixture(scope="module")
def fake():
    """Start fake cameras; one at a time, since there is but one port."""
    if shutil.which(FAKE) is None:
        pytest.skip(f"{FAKE} is absent: apt-get install aravis-tools")
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("libaravis-0.8 is absent: apt-get install gir1.2-aravis-0.8")
    running = []

    def start(*options):
        end()
        running.append(subprocess.Popen([FAKE, "-i", ADDRESS, *options], stdout=subprocess.DEVNULL))

    def end():
        while running:
            process = running.pop()
            process.kill()
            process.wait()

    start.end = end
    yield start
    end()


def workers():
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return {pid for pid in children if b"drivers.camera.worker" in Path(f"/proc/{pid}/cmdline").read_bytes()}


@pytest.fixture(scope="module", autouse=True)
def workers_before():
    """Workers of cameras that other tests of this process keep open."""
    return workers()


def opened(**settings):
    camera = make("camera", "aravis", "gige", {"address": ADDRESS, **settings})
    deadline_s = time.monotonic() + 60
    while True:
        try:
            camera.open()
            return camera
        except NotConnected:
            # It needs a moment to listen.
            if time.monotonic() > deadline_s:
                raise


@pytest.fixture(scope="module")
def camera(fake):
    fake()
    camera = opened(resend=False)
    yield camera
    camera.close()


@pytest.fixture(autouse=True)
def _stopped(request):
    yield
    if "camera" in request.fixturenames:
        request.getfixturevalue("camera").stop()


def test_what_it_is_and_can(camera):
    found = camera.capabilities()
    assert (found.vendor, found.model, found.serial_number) == ("Aravis", "Fake", "GV01")
    assert found.sensor_size_px == (2048, 2048)
    assert "Mono8" in found.pixel_formats
    assert set(found.triggers) >= {"free", "software"}
    assert found.has_region


def test_full_frames(camera):
    camera.configure(CameraSettings(exposure_us=20_000.0, pixel_format="Mono8", frame_rate_hz=20.0))
    camera.arm(3)
    frames = list(camera.frames(5))
    assert [frame.index for frame in frames] == [0, 1, 2]
    for frame in frames:
        assert (frame.image.shape, frame.image.dtype) == ((2048, 2048), np.uint8)
        assert np.ptp(frame.image) > 0
        assert frame.timestamp_s is not None


def test_a_region_an_exposure_and_a_rate(camera):
    told = camera.configure(FAST)
    assert (told.region, told.exposure_us, told.frame_rate_hz) == (SMALL, 1000.0, 50.0)
    camera.arm(6)
    frames = list(camera.frames(6))
    assert all(frame.image.shape == (128, 128) for frame in frames)
    # The median: this camera is a program too, and a busy machine holds it up for a frame or two.
    assert np.median(np.diff([frame.timestamp_s for frame in frames])) == pytest.approx(0.02, rel=0.3)


def test_sixteen_bits(camera):
    camera.configure(CameraSettings(pixel_format="Mono16", region=SMALL, frame_rate_hz=50.0))
    camera.arm(1)
    frame = camera.fetch(3)
    assert (frame.image.dtype, frame.bits, frame.image.shape) == (np.uint16, 16, (128, 128))


def test_a_software_trigger_takes_one_frame(camera):
    camera.configure(CameraSettings(exposure_us=1000.0, pixel_format="Mono8", region=SMALL, trigger="software"))
    camera.arm(2)
    with pytest.raises(TimedOut):
        camera.fetch(0.1)
    for number in range(2):
        camera.trigger()
        assert camera.fetch(3).index == number


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        (CameraSettings(exposure_us=1e12), Refused),
        (CameraSettings(region=Region(0, 0, 5000, 10)), Refused),
        (CameraSettings(pixel_format="Mono10"), Unsupported),
    ],
)
def test_what_it_cannot_do(camera, settings, error):
    with pytest.raises(error):
        camera.configure(settings)


def test_no_temperature(camera):
    with pytest.raises(Unsupported):
        camera.temperature_c()


def test_its_nodes_are_dumped(camera):
    found = camera.dump()
    assert b"RegisterDescription" in found.xml
    nodes = {node.name: node for node in found.nodes}
    assert (nodes["DeviceVendorName"].kind, nodes["DeviceVendorName"].value) == ("string", "Aravis")
    assert nodes["Width"].kind == "integer"


def test_its_process_is_replaced(camera):
    camera.configure(FAST)
    camera.arm()
    os.kill(camera.process_id, signal.SIGKILL)
    with pytest.raises(DeviceLost):
        deque(camera.frames(0.5))
    deadline_s = time.monotonic() + 60
    while True:
        # A GigE Vision camera keeps a client that vanished until its heartbeat is overdue.
        with contextlib.suppress(DeviceLost):
            camera.arm(1)
            break
        assert time.monotonic() < deadline_s
    assert camera.fetch(3).image.shape == (128, 128)


def test_losing_packets_is_told_and_shifts_no_index(fake, camera):
    camera.close()
    fake("-r", "20")
    lossy = opened(resend=False)
    lossy.configure(FAST)
    lossy.arm(40)
    fates = []
    for _ in range(40):
        try:
            fates.append(lossy.fetch(3).index)
        except IncompleteFrame:
            fates.append(None)
    with pytest.raises(Refused, match="all frames"):
        lossy.fetch(0.1)
    assert Counter(fates)[None] > 0
    assert any(fate is not None for fate in fates)
    assert all(fate in (None, position) for position, fate in enumerate(fates))
    counters = lossy.counters()
    assert (counters.delivered, counters.incomplete) == (40 - Counter(fates)[None], Counter(fates)[None])
    lossy.close()
    fake()
    reopened = opened(resend=False)
    reopened.close()
    camera.open()


def test_a_camera_that_is_switched_off_is_lost_and_comes_back(fake, camera):
    camera.configure(FAST)
    camera.arm()
    fake.end()
    start_s = time.monotonic()
    with pytest.raises(DeviceLost):
        deque(camera.frames(0.5))
    assert time.monotonic() - start_s < 60
    fake()
    time.sleep(0.3)
    camera.arm(1)
    assert camera.fetch(3).image.shape == (128, 128)


def test_nobody_at_the_address_and_no_library(fake, camera):
    camera.close()
    fake.end()
    with pytest.raises(NotConnected, match=ADDRESS):
        make("camera", "aravis", "gige", {"address": ADDRESS}).open()
    with pytest.raises(ConfigurationError, match="Aravis cannot be used") as caught:
        make("camera", "aravis", "gige", {"address": ADDRESS, "library": "libnone.so"}).open()
    assert caught.value.location == ("library",)


def test_nothing_of_it_stays(workers_before):
    assert workers() <= workers_before
