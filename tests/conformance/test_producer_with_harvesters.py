"""The simulated camera's GenTL producer, opened by plain harvesters: a client that nobody here wrote."""

import base64
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sims.camera import CameraServer, CameraSettings, CameraTwin
from sims.clock import Clock

WIDTH, HEIGHT = 64, 48
ANSWER_S = 30
CLOCK = Clock()


def picture(bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    image = np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) * 7 % (1 << bits)
    return image.astype(np.uint8) if bits == 8 else image.astype(np.uint16)


class HarvestersError(Exception):
    """What harvesters, or the GenICam library under it, raised; the text begins with its type's name."""


class Harvesters:
    """A process that runs plain harvesters; methods are those of harvesters_client.Client."""

    def __init__(self) -> None:
        command = [sys.executable, str(Path(__file__).with_name("harvesters_client.py"))]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __getattr__(self, call: str) -> Callable[..., Any]:
        def ask(*arguments: Any, **options: Any) -> Any:
            assert self._process.stdin
            assert self._process.stdout
            json.dump({"call": call, "arguments": arguments, "options": options}, self._process.stdin)
            self._process.stdin.write("\n")
            self._process.stdin.flush()
            answer = json.loads(self._process.stdout.readline())
            if "error" in answer:
                raise HarvestersError(f"{answer['error']}: {answer['text']}")
            return answer["result"]

        return ask

    def open(self, server: CameraServer) -> None:
        self.add(str(server.cti))
        self.devices()
        self.create(model="MQ042RG-CM")

    def frames(self, count: int) -> list[dict[str, Any]]:
        return [self.fetch() for _ in range(count)]

    def kill(self) -> None:
        self._process.kill()

    def end(self) -> None:
        self._process.communicate(timeout=ANSWER_S)


def pixels(frame: dict[str, Any]) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(frame["data"]), frame["dtype"])


@pytest.fixture(scope="module")
def process() -> Iterator[Harvesters]:
    harvesters = Harvesters()
    yield harvesters
    harvesters.end()


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., tuple[CameraTwin, CameraServer]]]:
    servers: list[CameraServer] = []

    def start(**options: Any) -> tuple[CameraTwin, CameraServer]:
        settings = CameraSettings(**{"size_px": (WIDTH, HEIGHT), **options})
        camera = CameraTwin(lambda _start_s, _exposure_us, bits: picture(bits), CLOCK, settings)
        server = CameraServer(camera, tmp_path)
        servers.append(server)
        server.start()
        return camera, server

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def camera(serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters) -> Iterator[CameraTwin]:
    """Return a camera that harvesters has opened."""
    twin, server = serve()
    process.open(server)
    yield twin
    process.destroy()
    process.reset()


def test_it_is_listed(serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters) -> None:
    _, server = serve()
    process.add(str(server.cti))
    (device,) = process.devices()
    assert device == {
        "id_": "irpmd-rig SIM00001",
        "vendor": "XIMEA GmbH",
        "model": "MQ042RG-CM",
        "serial_number": "SIM00001",
        "tl_type": "Custom",
        "access_status": 1,
    }
    process.reset()


@pytest.mark.usefixtures("camera")
def test_all_modules_have_node_maps_and_the_camera_says_that_it_is_simulated(process: Harvesters) -> None:
    assert process.module_nodes() == {
        "system": "irpmd-rig",
        "interface": 1,
        "device": "SIM00001",
        "stream": "Stream0",
    }
    assert process.get("DeviceVendorName") == "XIMEA GmbH"
    assert "SIMULATED" in process.get("DeviceManufacturerInfo")


@pytest.mark.usefixtures("camera")
def test_nodes_are_read_written_and_checked(process: Harvesters) -> None:
    process.set("ExposureTime", 1234.5)
    process.set("Width", 32)
    assert (process.get("ExposureTime"), process.get("Width")) == (1234.5, 32)
    assert process.limits("OffsetX") == [0, 32]
    with pytest.raises(HarvestersError, match="OutOfRangeException"):
        process.set("OffsetX", 36)
    with pytest.raises(HarvestersError, match="OutOfRangeException"):
        process.set("Gain", 100.0)
    with pytest.raises(HarvestersError, match="AccessException"):
        process.set("PayloadSize", 1)
    with pytest.raises(HarvestersError, match="InvalidArgumentException"):
        process.set("PixelFormat", "RGB8")
    assert not process.has("Focus")


def test_exposure_can_be_an_integer(serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters) -> None:
    _, server = serve(float_exposure=False)
    process.open(server)
    process.set("ExposureTime", 1500)
    value = process.get("ExposureTime")
    assert (value, type(value)) == (1500, int)
    process.destroy()
    process.reset()


@pytest.mark.usefixtures("camera")
@pytest.mark.parametrize(("name", "bits"), [("Mono8", 8), ("Mono10", 10), ("Mono10p", 10)])
def test_frames_hold_the_worlds_pixels(process: Harvesters, name: str, bits: int) -> None:
    process.set("PixelFormat", name)
    process.start()
    frames = process.frames(3)
    process.stop()
    ids = [frame["frame_id"] for frame in frames]
    assert ids == sorted(set(ids))
    for frame in frames:
        assert (frame["format"], frame["shape"]) == (name, [HEIGHT, WIDTH])
        assert (pixels(frame).reshape(HEIGHT, WIDTH) == picture(bits)).all()
    for earlier, later in pairwise(frames):
        assert later["timestamp_ns"] > earlier["timestamp_ns"]


@pytest.mark.usefixtures("camera")
def test_grouped_pixels_arrive_though_harvesters_miscounts_them(process: Harvesters) -> None:
    process.set("PixelFormat", "Mono10Packed")
    process.start()
    frame = process.fetch()
    process.stop()
    # harvesters 1.4.3 takes 10 bits a pixel where this format takes 12, and cuts the image off: a driver must not
    # use its component, but the buffer.
    assert pixels(frame).size < WIDTH * HEIGHT
    raw = np.frombuffer(base64.b64decode(frame["raw"]), np.uint8)
    first, middle, last = raw.reshape(-1, 3).astype(int).T
    unpacked = np.stack([first << 2 | middle & 3, last << 2 | middle >> 4 & 3], axis=1)
    assert (unpacked.reshape(HEIGHT, WIDTH) == picture(10)).all()


@pytest.mark.usefixtures("camera")
def test_a_region_arrives_with_its_place(process: Harvesters) -> None:
    for name, value in (("Width", 16), ("Height", 20), ("OffsetX", 12), ("OffsetY", 6)):
        process.set(name, value)
    process.start()
    frame = process.fetch()
    with pytest.raises(HarvestersError, match="AccessException"):
        process.set("Width", 32)  # locked while streaming
    process.stop()
    assert (frame["shape"], frame["offset"]) == ([20, 16], [6, 12])
    assert (pixels(frame).reshape(20, 16) == picture(8)[6:26, 12:28]).all()


def test_line_padding_is_announced_and_not_stripped(
    serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters
) -> None:
    _, server = serve(line_padding_bytes=8)
    process.open(server)
    assert process.get("PayloadSize") == (WIDTH + 8) * HEIGHT
    process.start()
    frame = process.fetch()
    process.stop()
    assert frame["padding"] == 8
    assert (pixels(frame).reshape(HEIGHT, WIDTH + 8)[:, :WIDTH] == picture(8)).all()
    process.destroy()
    process.reset()


def arm(process: Harvesters, source: str) -> None:
    process.set("TriggerSelector", "FrameStart")
    process.set("TriggerMode", "On")
    process.set("TriggerSource", source)
    process.start()


@pytest.mark.usefixtures("camera")
def test_a_software_trigger_takes_one_frame(process: Harvesters) -> None:
    arm(process, "Software")
    assert process.fetch(timeout=0.1) is None
    for number in range(3):
        process.execute("TriggerSoftware")
        assert process.fetch()["frame_id"] == number
    assert process.fetch(timeout=0.1) is None
    process.stop()


def test_hardware_triggers_are_taken_or_counted_as_missed(camera: CameraTwin, process: Harvesters) -> None:
    arm(process, "Line1")
    now_s = CLOCK.now()
    for offset_s in (0.0, 0.0001, 0.02):
        camera.trigger(now_s + offset_s)
    first, second = process.frames(2)
    assert second["timestamp_ns"] - first["timestamp_ns"] == pytest.approx(20_000_000, abs=2)
    assert process.fetch(timeout=0.1) is None
    process.set("CounterSelector", "MissedTriggers")
    assert process.get("CounterValue") == 1
    process.stop()


@pytest.mark.usefixtures("camera")
def test_a_burst_delivers_its_frames_for_one_trigger(process: Harvesters) -> None:
    process.set("TriggerSelector", "FrameBurstStart")
    process.set("AcquisitionBurstFrameCount", 3)
    process.set("TriggerSource", "Software")
    process.set("TriggerMode", "On")
    process.start()
    process.execute("TriggerSoftware")
    assert [frame["frame_id"] for frame in process.frames(3)] == [0, 1, 2]
    assert process.fetch(timeout=0.1) is None
    process.stop()


def test_dropped_frames_are_counted_and_leave_gaps(camera: CameraTwin, process: Harvesters) -> None:
    camera.faults.drop_next(2)
    arm(process, "Software")
    for _ in range(3):
        process.execute("TriggerSoftware")
        time.sleep(0.02)
    assert process.fetch()["frame_id"] == 2
    assert process.counts()["lost"] == 2
    process.stop()


@pytest.mark.usefixtures("camera")
def test_without_free_buffers_frames_are_lost_and_counted(process: Harvesters) -> None:
    process.start(num_buffers=3)
    time.sleep(0.3)
    counts = process.counts()
    assert counts["underruns"] > 0
    assert counts["lost"] >= counts["underruns"]
    assert (counts["announced"], counts["grabbing"]) == (3, True)
    process.stop()


def test_an_incomplete_buffer_is_flagged(camera: CameraTwin, process: Harvesters) -> None:
    camera.faults.incomplete_next(1, share=0.5)
    arm(process, "Software")
    process.execute("TriggerSoftware")
    size = WIDTH * HEIGHT
    assert process.fetch_any() == {
        "frame_id": 0,
        "complete": False,
        "filled": size // 2,
        "size": size,
        "rows": HEIGHT // 2,
    }
    process.execute("TriggerSoftware")
    assert process.fetch_any()["complete"]
    process.stop()


def test_a_failing_node_raises_and_works_again(camera: CameraTwin, process: Harvesters) -> None:
    camera.faults.fail_reads("DeviceTemperature")
    with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
        process.get("DeviceTemperature")
    assert process.get("DeviceTemperature") > 0
    camera.faults.fail_writes("Gain")
    with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
        process.set("Gain", 1.0)
    process.set("Gain", 1.0)


def test_a_camera_that_answers_late_times_out_and_is_not_out_of_step_afterwards(
    camera: CameraTwin, process: Harvesters
) -> None:
    camera.faults.answer_after(3.5)
    with pytest.raises(HarvestersError, match="Timeout"):
        process.get("Width")
    camera.faults.answer_after(0)
    assert process.get("Height") == HEIGHT


def test_after_unplugging_fetch_times_out_and_a_node_tells(camera: CameraTwin, process: Harvesters) -> None:
    process.start()
    process.fetch()
    camera.faults.unplug()
    while process.fetch(timeout=0.2) is not None:
        pass
    with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
        process.get("Width")
    camera.faults.replug()
    with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
        process.get("Width")  # an old handle stays lost
    with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
        process.stop()
    process.destroy()
    assert len(process.devices()) == 1
    process.create(model="MQ042RG-CM")
    process.start()
    assert process.fetch()["frame_id"] >= 0
    process.stop()


def test_an_unplugged_camera_is_not_listed(
    serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters
) -> None:
    camera, server = serve()
    camera.faults.unplug()
    process.add(str(server.cti))
    assert process.devices() == []
    camera.faults.replug()
    assert len(process.devices()) == 1
    server.close()
    assert process.devices() == []
    process.reset()


def test_a_second_client_is_told_that_the_camera_is_taken(camera: CameraTwin, tmp_path: Path) -> None:
    other = Harvesters()
    other.add(str(tmp_path / "irpmd-sim.cti"))
    assert [device["access_status"] for device in other.devices()] == [4]  # DEVICE_ACCESS_STATUS_BUSY
    with pytest.raises(HarvestersError, match="AccessDeniedException"):
        other.create()
    other.end()
    assert not camera.acquiring


def test_a_killed_client_frees_the_camera(
    serve: Callable[..., tuple[CameraTwin, CameraServer]], process: Harvesters
) -> None:
    camera, server = serve()
    victim = Harvesters()
    victim.open(server)
    victim.start()
    victim.fetch()
    assert camera.acquiring
    victim.kill()
    victim.end()
    deadline_s = time.monotonic() + 30
    while camera.acquiring and time.monotonic() < deadline_s:
        time.sleep(0.01)
    process.open(server)
    assert not camera.acquiring
    process.destroy()
    process.reset()


def settled_resources() -> tuple[int, int]:
    """Return this process's descriptors and threads, once the server has seen that its client is gone."""
    deadline_s = time.monotonic() + 30
    while time.monotonic() < deadline_s and any(thread.name == "camera client" for thread in threading.enumerate()):
        time.sleep(0.005)
    return sum(1 for _ in Path("/proc/self/fd").iterdir()), threading.active_count()


@pytest.mark.parametrize("unplug", [False, True])
def test_opening_and_closing_leaks_nothing(serve: Callable[..., tuple[CameraTwin, CameraServer]], unplug: bool) -> None:
    camera, server = serve()
    client = Harvesters()
    after: list[dict[str, int]] = []
    ours: list[tuple[int, int]] = []
    for _ in range(5):
        client.open(server)
        for _ in range(3):
            client.start()
            client.fetch()
            if not unplug:
                client.stop()
        if unplug:
            camera.faults.unplug()
            camera.faults.replug()
            with pytest.raises(HarvestersError, match=r"I[oO]Exception"):
                client.stop()
        client.destroy()
        client.reset()
        after.append(client.resources())
        camera.close()
        ours.append(settled_resources())
    client.end()
    assert ours[1:] == [ours[1]] * 4
    # From after the first: GenICam keeps some things of its own.
    assert after[1:] == [after[1]] * 4
    assert after[-1]["rings"] == 0
